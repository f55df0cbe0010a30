"""A table as values for JSON: rates in %, as printed; null where a dash is printed."""

from __future__ import annotations

from dataclasses import asdict

from prbench.leaderboard.tables import FEWEST_RANKED, MAIN_METRICS
from prbench.metrics import exported_unit
from prbench.workflows.table_two.layout import TableLayout

SCHEMA_VERSION = 1


def as_builtins(layout: TableLayout) -> dict[str, object]:
    """The whole layout with what its numbers mean."""
    return {
        "schema_version": SCHEMA_VERSION,
        "table": "2",
        "metrics": [
            {"id": info.id, "unit": exported_unit(info.unit), "higher_is_better": info.higher_is_better}
            for info in MAIN_METRICS
        ],
        "ranked_from": FEWEST_RANKED,
        **asdict(layout),
    }
