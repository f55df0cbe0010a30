"""Methods that run elsewhere: conditions out to a file, finished motions back in."""

from prbench.submitted.offline.conditions_file import ConditionsFile, SampledBatch
from prbench.submitted.offline.export import ExportReport, ExportRequest, export_conditions
from prbench.submitted.offline.files import read_conditions, read_conditions_file, write_conditions

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
