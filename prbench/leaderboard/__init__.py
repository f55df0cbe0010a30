"""Finished runs side by side: collected, kept apart where they do not compare, exported."""

from prbench.leaderboard.collect import collect_runs
from prbench.leaderboard.comparison import compare_runs
from prbench.leaderboard.export import export
from prbench.leaderboard.tables import make_leaderboard

__all__ = [
    "collect_runs",
    "compare_runs",
    "export",
    "make_leaderboard",
]
