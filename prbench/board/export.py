"""A leaderboard as Markdown, CSV (one number a row, like the published tables) or JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable

import msgspec

from prbench.board.as_markdown import as_markdown
from prbench.board.costs import MotionCost
from prbench.board.tables import DatasetTable, Leaderboard, MacroTable, TableRow, hides, undecided_lines
from prbench.errors import UsageError
from prbench.harness.benchmark import Benchmark
from prbench.harness.run_folder.means import intervals_of_means
from prbench.harness.run_folder.summary import EDGE_ARRIVAL
from prbench.metrics import MetricInfo, exported_unit, printed_scale
from prbench.shown import csv_text

_CSV_COLUMNS: tuple[str, ...] = (
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
    "detectable",
    "rank",
    "verified",
    "note",
    "kind",
    "seconds_per_motion",
    "passes_per_motion",
    "memory_mebibytes",
    "parameters",
)
_TEXT_COLUMNS = ("dataset", "condition", "method", "variant", "metric", "note")
_JSON_VERSION = 1


def export(leaderboard: Leaderboard, format: str) -> str:
    """The leaderboard as text that ends in a newline.

    Args:
        leaderboard: Of :func:`prbench.board.tables.make_leaderboard`.
        format: ``md``, ``csv`` or ``json``.

    Raises:
        UsageError: for another format.
    """
    if format not in FORMATS:
        raise UsageError(f"unknown format '{format}'; known ones are: {', '.join(FORMATS)}.")
    return FORMATS[format](leaderboard)


def _as_csv(leaderboard: Leaderboard) -> str:
    """Rates in %, metres and ratios as they are; an empty value where a dash is printed. UTF-8, LF."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _CSV_COLUMNS, lineterminator="\n")
    writer.writeheader()
    for number, table in enumerate(leaderboard.tables, start=1):
        writer.writerows(map(_csv_shown, _csv_dataset_rows(str(number), table)))
    for number, macro in enumerate(leaderboard.macro, start=1):
        writer.writerows(map(_csv_shown, _csv_macro_rows(f"macro {number}", macro)))
    return text.getvalue()


def _csv_shown(row: dict[str, str]) -> dict[str, str]:
    """A row whose names no spreadsheet takes for formulas; numbers may begin with a minus."""
    return row | {name: csv_text(row[name]) for name in _TEXT_COLUMNS}


def _csv_dataset_rows(number: str, table: DatasetTable) -> Iterable[dict[str, str]]:
    infos = _infos(table.benchmark)
    for row in table.rows:
        for metric in row.entry.summary.metrics:
            info = infos.get(metric.metric)
            scale = printed_scale(metric.unit)
            hidden = info is not None and hides(row.entry, info)
            notes = [*metric.marks, *(["synthetic"] if table.synthetic else [])]
            if not table.benchmark.about.default:
                notes.append(f"benchmark {table.benchmark.name}")
            if table.of:
                notes.append(f"common {table.sequences} of {table.of} sequences")
            if table.protocol:
                notes.append(f"own protocol {table.protocol}")
            if table.earlier_version is not None:
                notes.append(f"protocol version {table.earlier_version}")
            if hidden:
                notes.append("stands still")
            if row.entry.mark:
                notes.append(row.entry.mark)
            if EDGE_ARRIVAL in metric.flags:
                notes.append(row.entry.summary.edge_arrivals)
            yield {
                "table": number,
                "dataset": table.dataset,
                "condition": row.entry.record.condition,
                "method": row.entry.method,
                "variant": row.variant,
                "metric": metric.metric,
                # Empty where Markdown prints a dash, so that nobody averages a number that means nothing.
                "value": "" if hidden else _csv_number(scale * metric.mean),
                "unit": exported_unit(metric.unit),
                "higher_is_better": _csv_direction(info),
                "low": "" if hidden or metric.low is None else _csv_number(scale * metric.low),
                "high": "" if hidden or metric.high is None else _csv_number(scale * metric.high),
                "sequences": str(metric.sequences),
                "recordings": str(metric.recordings),
                "detectable": "" if hidden or metric.detectable is None else _csv_number(scale * metric.detectable),
                "rank": str(row.ranks.get(metric.metric, "")),
                "verified": "unverified" if row.entry.unverified else "verified",
                "note": "; ".join(notes),
                "kind": row.entry.origin,
                **_csv_cost(row.entry.cost),
            }


def _csv_cost(cost: MotionCost) -> dict[str, str]:
    values = (cost.seconds, cost.network_passes, cost.memory_mebibytes, cost.parameters)
    columns = ("seconds_per_motion", "passes_per_motion", "memory_mebibytes", "parameters")
    return {name: "" if value is None else _csv_number(value) for name, value in zip(columns, values, strict=True)}


def _csv_macro_rows(number: str, macro: MacroTable) -> Iterable[dict[str, str]]:
    about = ["mean over datasets", *(["synthetic"] if macro.synthetic else [])]
    if not macro.benchmark.about.default:
        about.append(f"benchmark {macro.benchmark.name}")
    infos = _infos(macro.benchmark)
    if macro.earlier_version is not None:
        about.append(f"protocol version {macro.earlier_version}")
    for row in macro.rows:
        for metric, mean in row.means.items():
            info = infos[metric]
            yield dict.fromkeys(_CSV_COLUMNS, "") | {
                "table": number,
                "dataset": "+".join(macro.datasets),
                "condition": row.condition,
                "method": row.method,
                "variant": row.variant,
                "metric": metric,
                "value": _csv_number(info.scale * mean.mean),
                "unit": exported_unit(info.unit),
                "higher_is_better": _csv_direction(info),
                "low": "" if mean.low is None else _csv_number(info.scale * mean.low),
                "high": "" if mean.high is None else _csv_number(info.scale * mean.high),
                "rank": str(row.ranks.get(metric, "")),
                "verified": "unverified" if row.unverified else "verified",
                "note": "; ".join(part for part in (*about, row.mark) if part),
                "kind": row.origin,
            }


def _infos(benchmark: Benchmark) -> dict[str, MetricInfo]:
    return {info.id: info for info in benchmark.metrics}


def _csv_direction(info: MetricInfo | None) -> str:
    direction = info.higher_is_better if info is not None else None
    return "" if direction is None else str(direction).lower()


def _csv_number(value: float) -> str:
    """Six decimals at most, without an exponent."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _as_json(leaderboard: Leaderboard) -> str:
    """Sorted keys, two-space indent."""
    value = {
        "schema_version": _JSON_VERSION,
        "tables": [_json_table(table) for table in leaderboard.tables],
        "macro_means": [_json_macro(macro) for macro in leaderboard.macro],
        "notes": list(leaderboard.notes),
    }
    return json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def _json_table(table: DatasetTable) -> dict[str, object]:
    protocol, identity, content, split, chosen = table.key
    named = {} if table.benchmark.about.default else {"benchmark": table.benchmark.name}
    return {
        **named,
        "dataset": table.dataset,
        "title": table.title,
        "synthetic": table.synthetic,
        "redistribution": table.redistribution,
        "protocol_digest": protocol,
        "identity_digest": identity,
        "content_digest": content,
        "split": split,
        "selection_digest": chosen,
        "own_protocol": table.protocol,
        "chosen_sequences": table.of or table.sequences,
        "left_sequences_out": list(table.shortest),
        "sequences": table.sequences,
        "recordings": table.recordings,
        "undecided": list(undecided_lines(table)),
        "rows": [_json_row(row) for row in table.rows],
    }


def _json_row(row: TableRow) -> dict[str, object]:
    entry = row.entry
    return {
        "run": entry.run,
        "method": entry.method,
        "kind": entry.record.method.kind,
        "package": entry.record.method.package,
        "isolation": entry.record.method.isolation,
        "mark": entry.mark,
        "version": entry.record.method.version,
        "weights_digest": entry.record.method.weights_digest,
        "condition": entry.record.condition,
        "control": entry.record.control,
        "variant": row.variant,
        "seed": entry.record.seed,
        "samples": entry.record.samples,
        "best_of": entry.record.best_of,
        "gaze": entry.record.method.gaze,
        "obstacles": entry.record.method.wants_obstacles,
        "carry_on": entry.record.carry_on,
        "scored": entry.scored,
        "verified": not entry.unverified,
        "why_unverified": entry.unverified,
        "unsupported": entry.summary.unsupported,
        "ranks": row.ranks,
        "leads": sorted(row.leads),
        "metrics": msgspec.to_builtins(entry.summary.metrics),
        "cost": {
            "seconds_per_motion": entry.cost.seconds,
            "passes_per_motion": entry.cost.network_passes,
            "memory_mebibytes": entry.cost.memory_mebibytes,
            "parameters": entry.cost.parameters,
        },
        "says_nothing": [info.id for info in entry.benchmark.metrics if hides(entry, info)],
    }


def _json_macro(macro: MacroTable) -> dict[str, object]:
    named = {} if macro.benchmark.about.default else {"benchmark": macro.benchmark.name}
    return {
        **named,
        "datasets": list(macro.datasets),
        "synthetic": macro.synthetic,
        "rows": [
            {
                "method": row.method,
                "kind": row.origin,
                "mark": row.mark,
                "condition": row.condition,
                "variant": row.variant,
                "means": {name: mean.mean for name, mean in row.means.items()},
                "intervals": intervals_of_means(row.means),
                "ranks": row.ranks,
                "verified": not row.unverified,
                "missing": list(row.missing),
            }
            for row in macro.rows
        ],
    }


FORMATS: dict[str, Callable[[Leaderboard], str]] = {"md": as_markdown, "csv": _as_csv, "json": _as_json}
