"""Finished runs side by side: collected, kept apart where they do not compare, exported."""

from prbench.board.collect import collect_runs
from prbench.board.comparison import compare_runs
from prbench.board.export import export
from prbench.board.tables import make_leaderboard

__all__ = ["collect_runs", "compare_runs", "export", "make_leaderboard"]
