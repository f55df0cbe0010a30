"""Finished runs side by side: collected, kept apart where they do not compare, exported."""

from prbench.leaderboard.collect import CollectedRuns, LeaderboardRow, collect_runs
from prbench.leaderboard.comparison import ComparedMetric, RunComparison, compare_runs
from prbench.leaderboard.export import FORMATS, export
from prbench.leaderboard.tables import DatasetTable, Leaderboard, MacroTable, make_leaderboard

__all__ = [
    "FORMATS",
    "CollectedRuns",
    "ComparedMetric",
    "DatasetTable",
    "Leaderboard",
    "LeaderboardRow",
    "MacroTable",
    "RunComparison",
    "collect_runs",
    "compare_runs",
    "export",
    "make_leaderboard",
]
