"""A leaderboard in long form, one number a row, in the columns of the published tables and some more."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

from prbench.leaderboard.tables import DatasetTable, Leaderboard, MacroTable, hides
from prbench.metrics import METRICS

COLUMNS: tuple[str, ...] = (
    "table",
    "dataset",
    "condition",
    "method",
    "variant",
    "metric",
    "value",
    "unit",
    "higher_is_better",
    "low",
    "high",
    "sequences",
    "recordings",
    "rank",
    "verified",
    "note",
)
_INFOS = {info.id: info for info in METRICS}
_UNITS = {"rate": "%", "m": "m", "ratio": "ratio"}


def as_csv(leaderboard: Leaderboard) -> str:
    """Rates in %, metres and ratios as they are; an empty value where a dash is printed. UTF-8, LF."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for number, table in enumerate(leaderboard.tables, start=1):
        writer.writerows(_dataset_rows(str(number), table))
    for number, macro in enumerate(leaderboard.macro, start=1):
        writer.writerows(_macro_rows(f"macro {number}", macro))
    return text.getvalue()


def _dataset_rows(number: str, table: DatasetTable) -> Iterable[dict[str, str]]:
    for row in table.rows:
        for metric in row.entry.summary.metrics:
            info = _INFOS.get(metric.metric)
            scale = 100.0 if metric.unit == "rate" else 1.0
            hidden = info is not None and hides(row.entry, info)
            notes = [*metric.marks, *(["synthetic"] if table.synthetic else [])]
            if hidden:
                notes.append("stands still")
            yield {
                "table": number,
                "dataset": table.dataset,
                "condition": row.entry.record.condition,
                "method": row.entry.method,
                "variant": row.variant,
                "metric": metric.metric,
                "value": "" if hidden else _number(scale * metric.mean),
                "unit": _UNITS[metric.unit],
                "higher_is_better": _direction(metric.metric),
                "low": "" if hidden or metric.low is None else _number(scale * metric.low),
                "high": "" if hidden or metric.high is None else _number(scale * metric.high),
                "sequences": str(metric.sequences),
                "recordings": str(metric.recordings),
                "rank": str(row.ranks.get(metric.metric, "")),
                "verified": "unverified" if row.entry.unverified else "verified",
                "note": "; ".join(notes),
            }


def _macro_rows(number: str, macro: MacroTable) -> Iterable[dict[str, str]]:
    for row in macro.rows:
        for metric, mean in row.means.items():
            info = _INFOS[metric]
            yield dict.fromkeys(COLUMNS, "") | {
                "table": number,
                "dataset": "+".join(macro.datasets),
                "condition": row.condition,
                "method": row.method,
                "variant": row.variant,
                "metric": metric,
                "value": _number((100.0 if info.unit == "rate" else 1.0) * mean),
                "unit": _UNITS[info.unit],
                "higher_is_better": _direction(metric),
                "rank": str(row.ranks.get(metric, "")),
                "verified": "unverified" if row.unverified else "verified",
                "note": "mean over datasets" + ("; synthetic" if macro.synthetic else ""),
            }


def _direction(metric: str) -> str:
    direction = _INFOS[metric].higher_is_better if metric in _INFOS else None
    return "" if direction is None else str(direction).lower()


def _number(value: float) -> str:
    """Six decimals at most, without an exponent."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
