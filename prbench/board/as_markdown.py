"""A leaderboard as Markdown: the main metrics, a table a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from prbench.board.costs import COST_TITLES
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
from prbench.harness.run_folder.record import CONTROL
from prbench.metrics import MetricInfo, printed_unit
from prbench.protocol.benchmarks import default_benchmark
from prbench.shown import markdown, markdown_code

_DASH = "–"
_FEW = "†"


def as_markdown(leaderboard: Leaderboard) -> str:
    """The whole document."""
    found = dict.fromkeys(table.benchmark.about.title for table in leaderboard.tables)
    several = len(found) > 1
    blocks = ["# Leaderboard" if several else f"# {next(iter(found), default_benchmark().title)} leaderboard"]
    for table in leaderboard.tables:
        blocks += _dataset_blocks(table, shared_name=_repeats(table, leaderboard), with_benchmark=several)
    for macro in leaderboard.macro:
        blocks += _macro_blocks(macro, with_benchmark=several)
    if leaderboard.notes:
        blocks += ["## Notes", "\n".join(f"- {markdown(note)}" for note in leaderboard.notes)]
    return "\n\n".join(blocks) + "\n"


def _dataset_blocks(table: DatasetTable, *, shared_name: bool, with_benchmark: bool) -> list[str]:
    metrics = table.benchmark.main_metrics
    counts = f"{table.sequences} sequences, {table.recordings} recording{'' if table.recordings == 1 else 's'}"
    if table.of:
        counts += f" of {table.of} that every method here generated"
    title = f"## {markdown(table.title)}, {markdown_code(table.dataset)}: {markdown(table.split)}, {counts}"
    if with_benchmark:
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
    return [title, _grid(header, rows, metrics), "\n".join(f"- {line}" for line in _legend(table))]


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
    metrics = macro.benchmark.main_metrics
    word = " (synthetic data among them)" if macro.synthetic else ""
    title = f"## Mean over datasets: {', '.join(map(markdown, macro.datasets))}{word}"
    if with_benchmark:
        title += f", {macro.benchmark.about.title.lower()}"
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


def _repeats(table: DatasetTable, leaderboard: Leaderboard) -> bool:
    key = (table.benchmark.name, table.dataset)
    return sum((other.benchmark.name, other.dataset) == key for other in leaderboard.tables) > 1
