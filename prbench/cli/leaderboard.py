"""``prbench leaderboard``: finished runs side by side."""

from __future__ import annotations

from prbench.cli.commands import Group

EXAMPLE = "prbench leaderboard export runs/static runs/ground-truth --format md --out leaderboard.md"

leaderboard = Group(
    "leaderboard",
    sections={
        "commands": {
            "export": "prbench.cli.leaderboard_export:export",
            "compare": "prbench.cli.leaderboard_compare:compare",
            "pareto": "prbench.cli.pareto:pareto",
        }
    },
    example=EXAMPLE,
    help="Put finished runs side by side.",
)
