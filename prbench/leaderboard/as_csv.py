"""A leaderboard in long form, one number a row, in the columns of the published tables and some more."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

from prbench.leaderboard.tables import DatasetTable, Leaderboard, MacroTable, hides
from prbench.metrics import METRICS, exported_unit, printed_scale
from prbench.shown import csv_text

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
    "kind",
)
_NAMES = ("dataset", "condition", "method", "variant", "metric", "note")
_INFOS = {info.id: info for info in METRICS}


def as_csv(leaderboard: Leaderboard) -> str:
    """Rates in %, metres and ratios as they are; an empty value where a dash is printed. UTF-8, LF."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for number, table in enumerate(leaderboard.tables, start=1):
        writer.writerows(map(_shown, _dataset_rows(str(number), table)))
    for number, macro in enumerate(leaderboard.macro, start=1):
        writer.writerows(map(_shown, _macro_rows(f"macro {number}", macro)))
    return text.getvalue()


def _shown(row: dict[str, str]) -> dict[str, str]:
    """A row whose names no spreadsheet takes for formulas; numbers may begin with a minus."""
    return row | {name: csv_text(row[name]) for name in _NAMES}


def _dataset_rows(number: str, table: DatasetTable) -> Iterable[dict[str, str]]:
    for row in table.rows:
        for metric in row.entry.summary.metrics:
            info = _INFOS.get(metric.metric)
            scale = printed_scale(metric.unit)
            hidden = info is not None and hides(row.entry, info)
            notes = [*metric.marks, *(["synthetic"] if table.synthetic else [])]
            if hidden:
                notes.append("stands still")
            if row.entry.mark:
                notes.append(row.entry.mark)
            yield {
                "table": number,
                "dataset": table.dataset,
                "condition": row.entry.record.condition,
                "method": row.entry.method,
                "variant": row.variant,
                "metric": metric.metric,
                "value": "" if hidden else _number(scale * metric.mean),
                "unit": exported_unit(metric.unit),
                "higher_is_better": _direction(metric.metric),
                "low": "" if hidden or metric.low is None else _number(scale * metric.low),
                "high": "" if hidden or metric.high is None else _number(scale * metric.high),
                "sequences": str(metric.sequences),
                "recordings": str(metric.recordings),
                "rank": str(row.ranks.get(metric.metric, "")),
                "verified": "unverified" if row.entry.unverified else "verified",
                "note": "; ".join(notes),
                "kind": row.entry.origin,
            }


def _macro_rows(number: str, macro: MacroTable) -> Iterable[dict[str, str]]:
    about = ["mean over datasets", *(["synthetic"] if macro.synthetic else [])]
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
                "value": _number(info.scale * mean),
                "unit": exported_unit(info.unit),
                "higher_is_better": _direction(metric),
                "rank": str(row.ranks.get(metric, "")),
                "verified": "unverified" if row.unverified else "verified",
                "note": "; ".join(part for part in (*about, row.mark) if part),
                "kind": row.origin,
            }


def _direction(metric: str) -> str:
    direction = _INFOS[metric].higher_is_better if metric in _INFOS else None
    return "" if direction is None else str(direction).lower()


def _number(value: float) -> str:
    """Six decimals at most, without an exponent."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
