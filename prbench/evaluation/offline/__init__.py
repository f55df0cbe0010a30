"""Methods that run elsewhere: conditions out to a file, finished motions back in."""

from prbench.evaluation.offline.conditions_file import ConditionsFile, SampledBatch
from prbench.evaluation.offline.export import ExportReport, ExportRequest, export_conditions
from prbench.evaluation.offline.read import read_conditions, read_conditions_file, write_conditions

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
