"""The layout of the authors' release: import it with everything inferred written down, and export any table to it."""

from prbench.release.exporting import ExportReport, export_release
from prbench.release.importing import FailedDataset, ImportResult, import_release
from prbench.release.interpret import ImportOptions
from prbench.release.report import ImportReport

__all__ = [
    "ExportReport",
    "FailedDataset",
    "ImportOptions",
    "ImportReport",
    "ImportResult",
    "export_release",
    "import_release",
]
