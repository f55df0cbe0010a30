"""A leaderboard as Markdown, CSV (one number a row, like the published tables) or JSON.

A leaderboard as Markdown: the main metrics, a table a dataset.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Sequence

import msgspec

from prbench.board.collect import COST_TITLES, MotionCost
from prbench.board.tables import (
    FEWEST_RANKED,
    DatasetTable,
    Leaderboard,
    MacroRow,
    MacroTable,
    TableRow,
    hides,
    undecided_lines,
)
from prbench.errors import UsageError
from prbench.harness.benchmark import Benchmark, load_benchmark
from prbench.harness.run_folder.record import CONTROL, RunRecord
from prbench.harness.run_folder.summary import EDGE_ARRIVAL, DatasetSummary
from prbench.metrics import MetricInfo, exported_unit, printed_scale, printed_unit
from prbench.protocol.manifests import default_benchmark
from prbench.shown import csv_text, markdown, markdown_code

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
    benchmark = load_benchmark(macro.benchmark)
    about = ["mean over datasets", *(["synthetic"] if macro.synthetic else [])]
    if not benchmark.about.default:
        about.append(f"benchmark {benchmark.name}")
    infos = _infos(benchmark)
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


class BoardRow(msgspec.Struct, frozen=True, kw_only=True):
    """One run in the table of a dataset."""

    run: str
    """Name of the run folder."""
    record: RunRecord
    """The content of its ``run.json``: method, version, weights, condition, seed."""
    summary: DatasetSummary
    """Its scores, as in ``summary.json``; of the table's sequences alone."""
    cost: MotionCost
    """Cost of a motion, on the machine of the run."""
    origin: str
    """Whose method it is, in words; a record that claims a method for prbench without right is not believed."""
    mark: str
    """A remark about its motions that readers must know; empty if there is none."""
    unverified: str
    """Why the scores were not held against the motions; empty if they were."""
    variant: str
    """Control, weights, options and the like, by which rows of one method differ."""
    ranks: dict[str, int]
    """Maps ids of metrics to ranks: one more than the number of methods that are better by a supported difference."""
    leads: list[str]
    """Ids of metrics in which it is better than every other method, each by a supported difference."""
    says_nothing: list[str]
    """Ids of metrics that say nothing about this method, because it stands still."""


class BoardTable(msgspec.Struct, frozen=True, kw_only=True):
    """Runs on one dataset that compare: protocol, table, split and sequences agree."""

    dataset: str
    """Name of the dataset."""
    title: str
    """The same for readers; holds the word "synthetic" where the data are."""
    benchmark: str
    """Name of the benchmark."""
    synthetic: bool
    """Whether the data are synthetic."""
    redistribution: str
    """Whether the licence lets recorded motion be passed on."""
    split: str
    """Split of the table."""
    digests: dict[str, str]
    """Of the ``protocol``, of the table's ``identity`` and ``content``, and of the ``selection`` of sequences."""
    own_protocol: str
    """Name and version of a protocol of the user's own; empty for prbench's."""
    sequences: int
    """Number of sequences."""
    recordings: int
    """Number of recordings that they come from."""
    chosen_sequences: int
    """Number of the chosen sequences; above ``sequences`` where the table is of those that every method generated."""
    left_sequences_out: tuple[str, ...]
    """Methods that left chosen sequences out, with how many."""
    undecided: tuple[str, ...]
    """Sentences on what the data cannot decide, and the smallest differences that they can."""
    rows: list[BoardRow]
    """The runs, sorted by condition, controls last."""


class Board(msgspec.Struct, frozen=True, kw_only=True):
    """A leaderboard; ``--format json`` writes the same."""

    schema_version: int = 2
    """Version of this shape."""
    tables: list[BoardTable]
    """One table for each dataset and way of scoring it."""
    macro_means: tuple[MacroTable, ...]
    """Means over datasets, for each protocol with two datasets or more."""
    notes: tuple[str, ...]
    """What was left out, and which tables must not be compared."""


def as_board(leaderboard: Leaderboard) -> Board:
    """Return what a leaderboard is in JSON."""
    tables = []
    for table in leaderboard.tables:
        protocol, identity, content, split, selection = table.key
        rows = [
            BoardRow(
                run=row.entry.run,
                record=row.entry.record,
                summary=row.entry.summary,
                cost=row.entry.cost,
                origin=row.entry.origin,
                mark=row.entry.mark,
                unverified=row.entry.unverified,
                variant=row.variant,
                ranks=row.ranks,
                leads=sorted(row.leads),
                says_nothing=[info.id for info in table.benchmark.metrics if hides(row.entry, info)],
            )
            for row in table.rows
        ]
        shown = BoardTable(
            dataset=table.dataset,
            title=table.title,
            benchmark=table.benchmark.name,
            synthetic=table.synthetic,
            redistribution=table.redistribution,
            split=split,
            digests={"protocol": protocol, "identity": identity, "content": content, "selection": selection},
            own_protocol=table.protocol,
            sequences=table.sequences,
            recordings=table.recordings,
            chosen_sequences=table.of or table.sequences,
            left_sequences_out=table.shortest,
            undecided=undecided_lines(table),
            rows=rows,
        )
        tables.append(shown)
    return Board(tables=tables, macro_means=leaderboard.macro, notes=leaderboard.notes)


def _as_json(leaderboard: Leaderboard) -> str:
    """Sorted keys, two-space indent."""
    value = msgspec.to_builtins(as_board(leaderboard))
    return json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


_DASH = "–"
_FEW = "†"


def as_markdown(leaderboard: Leaderboard) -> str:
    """The whole document."""
    found = dict.fromkeys(table.benchmark.about.title for table in leaderboard.tables)
    several = len(found) > 1
    blocks = ["# Leaderboard" if several else f"# {next(iter(found), default_benchmark().title)} leaderboard"]
    for table in leaderboard.tables:
        key = (table.benchmark.name, table.dataset)
        shared_name = sum((other.benchmark.name, other.dataset) == key for other in leaderboard.tables) > 1
        metrics = table.benchmark.main_metrics
        counts = f"{table.sequences} sequences, {table.recordings} recording{'' if table.recordings == 1 else 's'}"
        if table.of:
            counts += f" of {table.of} that every method here generated"
        title = f"## {markdown(table.title)}, {markdown_code(table.dataset)}: {markdown(table.split)}, {counts}"
        if several:
            title += f", {table.benchmark.about.title.lower()}"
        if table.protocol:
            title += f", own protocol {markdown(table.protocol)}"
        if table.earlier_version is not None:
            title += f", protocol version {table.earlier_version}"
        if shared_name:
            # Two tables of one dataset differ in a digest at most, so their titles have to show digests.
            protocol, identity, content, _, chosen = (part[:8] for part in table.key)
            title += f" (protocol {protocol}, table {identity}/{content}, chosen {chosen})"
        header = ["Condition", "Method", "Variant", *(_column(info) for info in metrics), *COST_TITLES, "Kind"]
        rows = [
            [
                "control" if row.entry.record.method.kind == CONTROL else markdown(row.entry.record.condition),
                _marked(row.entry.method, row.entry.summary.symbols),
                _variant(row.variant, unverified=bool(row.entry.unverified)),
                *(_cell(row, info) for info in metrics),
                *row.entry.cost.cells,
                markdown(row.entry.origin),
            ]
            for row in table.rows
        ]
        blocks += [title, _grid(header, rows, metrics), "\n".join(f"- {line}" for line in _legend(table))]
    for macro in leaderboard.macro:
        blocks += _macro_blocks(macro, with_benchmark=several)
    if leaderboard.notes:
        blocks += ["## Notes", "\n".join(f"- {markdown(note)}" for note in leaderboard.notes)]
    return "\n\n".join(blocks) + "\n"


def _variant(text: str, *, unverified: bool) -> str:
    return "; ".join(part for part in (markdown(text), "unverified" if unverified else "") if part)


def _marked(method: str, symbols: str) -> str:
    return f"{markdown(method)} {symbols}" if symbols else markdown(method)


def _cell(row: TableRow, info: MetricInfo) -> str:
    """Mean and interval in the printed unit, in bold where it is better than all others of its condition."""
    metric = row.entry.metric(info.id)
    if metric is None:
        return ""
    if hides(row.entry, info):
        return _DASH
    scale = info.scale
    mean = f"{scale * metric.mean:.2f}"
    text = f"**{mean}**" if info.id in row.leads else mean
    if metric.low is not None and metric.high is not None:
        text += f" [{scale * metric.low:.2f}, {scale * metric.high:.2f}]"
    return text + (f" {_FEW}" if "few_recordings" in metric.marks else "")


def _legend(table: DatasetTable) -> Iterable[str]:
    yield "Rates in %, with 95 % intervals over recordings in brackets."
    yield (
        "Cost as the harness measured it on the machine of each run, batched as it was; memory of the device, else of"
        " the process; passes as the method declares them. A dash: not measured."
    )
    if table.synthetic:
        yield "These are scores on synthetic data; they say nothing about real people."
    if any("few_recordings" in metric.marks for row in table.rows for metric in row.entry.summary.metrics):
        yield f"{_FEW} few recordings (below ten): the interval says little."
    if table.of:
        yield (
            f"Sequences of {table.of} that are longer than a method can generate are left out for all:"
            f" {', '.join(map(markdown, table.shortest))}."
        )
    if table.protocol:
        yield f"Scored under a protocol of the user's own, {markdown(table.protocol)}: no number here is the study's."
    if table.earlier_version is not None:
        present = table.benchmark.present_rules.version
        yield (
            f"Scored under version {table.earlier_version} of the protocol; version {present} is the"
            " present one, and no number of the two is comparable. Run the methods again to compare them."
        )
    if table.sequences < FEWEST_RANKED:
        yield f"Nothing is ranked: fewer than {FEWEST_RANKED} sequences."
    elif any(row.ranks for row in table.rows):
        yield (
            "Bold: better than every other method under its condition, each by a difference that the data support"
            " (Holm's correction for all pairs and metrics of the condition); controls are not ranked."
        )
        yield from _groups(table)
    yield from map(markdown, undecided_lines(table))
    for row in table.rows:
        # Remarks stand under the table, because a cell has no room for a sentence.
        if row.entry.mark:
            yield f"{markdown(row.entry.method)} {row.entry.mark}."
        if row.entry.summary.edge_arrivals:
            yield f"{markdown(row.entry.method)}: {row.entry.summary.edge_arrivals}."
        if row.entry.summary.unsupported:
            yield (
                f"{markdown(row.entry.method)}: {row.entry.summary.unsupported} sequences are longer than it can"
                " generate and were left out; not ranked."
            )
    reasons = dict.fromkeys(row.entry.unverified for row in table.rows if row.entry.unverified)
    for reason in reasons:
        yield f"Unverified: scores that were not held against the motions, because {markdown(reason)}."
    if table.redistribution == "non-commercial":
        yield "The data may be used for non-commercial purposes only."
    elif table.redistribution == "none":
        yield "The data may not be passed on; this page holds scores only, no recorded motion and no goals."


def _groups(table: DatasetTable) -> Iterable[str]:
    """Yield the metrics of each condition in which the data separate no two methods, and the order of the others."""
    for condition in dict.fromkeys(row.entry.record.condition for row in table.rows if row.ranks):
        rows = [row for row in table.rows if row.entry.record.condition == condition and row.ranks]
        alike = []
        for info in table.benchmark.main_metrics:
            ranks = {row.ranks[info.id] for row in rows if info.id in row.ranks}
            if ranks == {1}:
                alike.append(info.title)
        if alike:
            yield f"{markdown(condition)}: the data separate no two methods in {', '.join(alike)}."
        for info in table.benchmark.main_metrics:
            if info.title in alike or not any(info.id in row.ranks for row in rows):
                continue
            groups: dict[int, list[str]] = {}
            for row in rows:
                if info.id in row.ranks:
                    name = " ".join(part for part in (row.entry.method, row.variant) if part)
                    groups.setdefault(row.ranks[info.id], []).append(markdown(name))
            parts = [f"{rank}. {', '.join(names)}" for rank, names in sorted(groups.items())]
            yield f"{markdown(condition)}, {info.title}: {'; '.join(parts)} (methods of one group are not separated)."


def _macro_blocks(macro: MacroTable, *, with_benchmark: bool) -> list[str]:
    benchmark = load_benchmark(macro.benchmark)
    metrics = benchmark.main_metrics
    word = " (synthetic data among them)" if macro.synthetic else ""
    title = f"## Mean over datasets: {', '.join(map(markdown, macro.datasets))}{word}"
    if with_benchmark:
        title += f", {benchmark.about.title.lower()}"
    if macro.earlier_version is not None:
        title += f", protocol version {macro.earlier_version}"
    header = ["Condition", "Method", "Variant", *(_column(info) for info in metrics), "Missing", "Kind"]
    rows = [
        [
            "control" if row.is_control else markdown(row.condition),
            _marked(row.method, row.symbols),
            _variant(row.variant, unverified=row.unverified),
            *(_macro_cell(row, info) for info in metrics),
            ", ".join(map(markdown, row.missing)),
            markdown(row.origin),
        ]
        for row in macro.rows
    ]
    legend = (
        "- Every dataset counts alike; in brackets the 95 % interval of the mean. In parentheses: one more than the"
        " number of methods of its condition that are better on every dataset by a supported difference; none for"
        " methods without a dataset."
    )
    return [title, _grid(header, rows, metrics), legend]


def _macro_cell(row: MacroRow, info: MetricInfo) -> str:
    if info.id not in row.means:
        return _DASH if row.means else ""
    rank = f" ({row.ranks[info.id]})" if info.id in row.ranks else ""
    found = row.means[info.id]
    bounds = ""
    if found.low is not None and found.high is not None:
        bounds = f" [{info.scale * found.low:.2f}, {info.scale * found.high:.2f}]"
    return f"{info.scale * found.mean:.2f}{bounds}{rank}"


def _column(info: MetricInfo) -> str:
    unit = printed_unit(info.unit).strip()
    return f"{info.title}{info.arrow}{f' ({unit})' if unit else ''}"


def _grid(header: Sequence[str], rows: Sequence[Sequence[str]], metrics: Sequence[MetricInfo]) -> str:
    numbers = {*map(_column, metrics), *COST_TITLES}
    rule = ["---:" if name in numbers else "---" for name in header]
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, rule, *rows])


FORMATS: dict[str, Callable[[Leaderboard], str]] = {"md": as_markdown, "csv": _as_csv, "json": _as_json}
