"""Methods that run elsewhere: conditions out to a file, finished motions back in."""

from prbench.harness.offline.conditions_file import ConditionsFile, SampledBatch
from prbench.harness.offline.export import ExportReport, ExportRequest, export_conditions
from prbench.harness.offline.files import read_conditions, read_conditions_file, write_conditions

__all__ = [
    "ConditionsFile",
    "ExportReport",
    "ExportRequest",
    "SampledBatch",
    "export_conditions",
    "read_conditions",
    "read_conditions_file",
    "write_conditions",
]
