"""A board as a folder of pages that opens from disk: tables, charts, a page a run, pairs of runs, motions on demand."""

from prbench.board.site.pages import About
from prbench.board.site.write import MARKER, SiteReport, write_site

__all__ = ["MARKER", "About", "SiteReport", "write_site"]
