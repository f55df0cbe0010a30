"""``prbench prediction``: the study's tables of motion prediction, and pictures of futures."""

from __future__ import annotations

from prbench.cli.commands import Group

prediction = Group(
    "prediction",
    section="board",
    sections={
        "commands": {
            "tables": "prbench_benchmarks.motion_prediction.tables_commands:tables",
            "view": "prbench_benchmarks.motion_prediction.view_commands:view",
        }
    },
    example="prbench prediction tables windows/mogaze --out tables/mogaze",
    help="Motion prediction on windows (`prbench build-windows`): the study's tables, pictures of futures.",
)
