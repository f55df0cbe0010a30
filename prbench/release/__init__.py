"""The layout of the authors' release: import it with everything inferred written down, and export any table to it."""

from prbench.release.exporting import export_release
from prbench.release.importing import import_release
from prbench.release.interpret import ImportOptions
from prbench.release.report import ImportReport

__all__ = [
    "ImportOptions",
    "ImportReport",
    "export_release",
    "import_release",
]
