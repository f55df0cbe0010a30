"""``prbench prediction``: the study's tables of motion prediction, and pictures of futures."""

from __future__ import annotations

from prbench.cli.commands import Group

prediction = Group(
    "prediction",
    sections={
        "commands": {
            "tables": "prbench.cli.prediction_tables:tables",
            "view": "prbench.cli.prediction_view:view",
        }
    },
    example="prbench prediction tables windows/mogaze --out tables/mogaze",
    help="Motion prediction on windows (`prbench build-windows`): the study's tables, pictures of futures.",
)
