"""A leaderboard as Markdown, CSV (one number a row, like the published tables) or JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from prbench.board.collect import COSTS
from prbench.board.tables import FEWEST_RANKED, DatasetTable, Leaderboard, MacroTable, TableRow, hides, undecided_lines
from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.errors import UsageError
from prbench.harness.benchmark import Benchmark, load_benchmark
from prbench.harness.claims import METHOD
from prbench.harness.run_folder.record import CONTROL, RunRecord
from prbench.harness.run_folder.summary import DatasetSummary, counted_units
from prbench.protocol.manifests import default_benchmark
from prbench.tables import Block, Cell, Column, Row, Table, as_markdown, csv_lines, metric_cell, metric_column, note_of

_CSV_COLUMNS = (
    *("table", "dataset", "condition", "method", "variant", "metric", "value", "unit", "higher_is_better"),
    *("low", "high", "sequences", "recordings", "detectable", "rank", "verified", "note", "kind"),
    *(column for _, column in COSTS.values()),
    *("declared", "signed_by", "submission", "training"),
)
_FEW = "†"
FORMATS = ("md", "csv", "json")
# Columns of boards that submissions come to.
_SUBMITTED = {"verified": "Verified", "training": "Training data (declared)"}


def export(leaderboard: Leaderboard, format: str) -> str:
    """Return the leaderboard as text that ends in a newline.

    Args:
        leaderboard: Result of :func:`prbench.board.tables.make_leaderboard`.
        format: ``md``; ``csv``, with rates in %, and an empty value where Markdown has a dash; or ``json``.

    Raises:
        UsageError: for another format.
    """
    if format not in FORMATS:
        raise UsageError(f"unknown format '{format}'; known ones are: {', '.join(FORMATS)}.")
    if format == "md":
        found = dict.fromkeys(table.benchmark.about.title for table in leaderboard.tables)
        title = "# Leaderboard" if len(found) > 1 else f"# {next(iter(found), default_benchmark().title)} leaderboard"
        notes = [Table(title="Notes", notes=leaderboard.notes)] if leaderboard.notes else []
        return f"{title}\n\n{as_markdown([*board_tables(leaderboard), *notes])}"
    if format == "csv":
        signed = {"signed_by": leaderboard.signed_by}
        return csv_lines(_CSV_COLUMNS, (row | signed for row in _csv_rows(leaderboard)))
    value = msgspec.to_builtins(as_board(leaderboard))
    return json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def measured_cells(row: TableRow, table: DatasetTable, **about: Any) -> tuple[Cell, ...]:
    """Return all metrics of a run in printed units.

    Args:
        row: The run.
        table: Table in which the run stands.
        about: Other fields of each cell.
    """
    entry = row.entry
    infos = {info.id: info for info in table.benchmark.metrics}
    common: dict[str, Any] = {"variant": row.variant, "dataset": table.dataset, "method": entry.method}
    common |= {"condition": entry.record.condition} | about
    of_table = (
        "synthetic" if table.synthetic else "",
        "" if table.benchmark.about.default else f"benchmark {table.benchmark.name}",
        f"common {table.sequences} of {table.of} sequences" if table.of else "",
        f"own protocol {table.protocol}" if table.protocol else "",
        "" if table.earlier_version is None else f"protocol version {table.earlier_version}",
    )
    cells = []
    for metric in entry.summary.metrics:
        hidden = metric.metric in infos and hides(entry, infos[metric.metric])
        arrival = entry.summary.arrival if metric.metric == "prime_success" else ""
        notes = (*metric.marks, *of_table, "stands still" if hidden else "", entry.summary.mark, arrival)
        own_start = entry.summary.own_first_frame if metric.metric == "plausible" else ""
        # No value where Markdown prints a dash, so that nobody averages a number that means nothing.
        numbers = (None if hidden else metric.mean, metric.low, metric.high)
        own = {"rank": row.ranks.get(metric.metric), "best": metric.metric in row.leads}
        own |= {name: getattr(metric, name) for name in ("detectable", "sequences", "recordings")}
        own |= {"mark": f"{arrival[:1]} {_FEW if 'few_recordings' in metric.marks else ''}".strip()}
        own |= {"note": note_of(*notes, own_start)}
        cells.append(metric_cell(metric.metric, metric.unit, *numbers, **own, **common))
    return tuple(cells)


def _csv_rows(leaderboard: Leaderboard) -> Iterator[dict[str, Any]]:
    for number, table in enumerate(leaderboard.tables, start=1):
        for row in table.rows:
            entry = row.entry
            about: dict[str, Any] = {column: entry.cost[key] for key, (_, column) in COSTS.items()}
            about |= {"table": str(number), "verified": entry.remarks or entry.verified}
            about |= {"submission": entry.submission, "training": entry.training}
            about |= {"kind": entry.origin, "declared": note_of(*entry.declared)}
            yield from (_csv_row(cell, table.benchmark) | about for cell in measured_cells(row, table))
    for number, macro in enumerate(leaderboard.macro, start=1):
        benchmark = load_benchmark(macro.benchmark)
        notes = ["mean over datasets", "synthetic" if macro.synthetic else ""]
        notes.append("" if benchmark.about.default else f"benchmark {benchmark.name}")
        notes.append("" if macro.earlier_version is None else f"protocol version {macro.earlier_version}")
        for row, cells in zip(macro.rows, _macro_cells(macro, benchmark)):
            about = {name: getattr(row, name) for name in ("condition", "method", "variant", "training")}
            about |= {"table": f"macro {number}", "dataset": "+".join(macro.datasets), "kind": row.origin}
            about |= {"declared": note_of(*row.declared), "note": note_of(*notes, row.mark)}
            about |= {"verified": "unverified" if row.unverified else "verified"}
            yield from (_csv_row(cell, benchmark) | about for cell in cells if cell.metric in row.means)


def _csv_row(cell: Cell, benchmark: Benchmark) -> dict[str, Any]:
    better = {info.id: info.higher_is_better for info in benchmark.metrics}
    return msgspec.structs.asdict(cell) | {"higher_is_better": better.get(cell.metric)}


class BoardRow(msgspec.Struct, frozen=True, kw_only=True):
    """One run in the table of a dataset.

    Attributes:
        run: Name of the run folder.
        record: The content of its ``run.json``: method, version, weights, condition, seed.
        summary: Its scores, as in ``summary.json``; of the table's sequences alone.
        cost: Cost of a motion, on the machine of the run: ``seconds``, ``processor_seconds``, ``network_passes``,
            ``memory_mebibytes``, ``parameters``; null where nothing was measured or declared.
        origin: Whose method it is, in words; a record that claims a method for prbench without right is not believed.
        mark: A remark about its motions that readers must know; empty if there is none.
        unverified: Why the scores were not held against the motions; empty if they were.
        unverified_cost: Why ``cost.json`` is not believed; empty where nothing contradicts it.
        declared: What the run's own files say, and nothing at hand can show: ``method``, ``cost`` and the like.
        variant: Control, weights, options and the like, by which rows of one method differ.
        ranks: Maps ids of metrics to ranks: one more than the number of methods that are better by a supported
            difference.
        leads: Ids of metrics in which it is better than every other method, each by a supported difference.
        says_nothing: Ids of metrics that say nothing about this method, because it stands still.
        submission: Id of the submission that it came in to a board; empty for a run folder.
        verified: How its scores were held against the motions, in words, where they were.
        training: What the method was trained on, as its submission declares it.
    """

    run: str
    record: RunRecord
    summary: DatasetSummary
    cost: dict[str, float | None]
    origin: str
    mark: str
    unverified: str
    unverified_cost: str
    declared: tuple[str, ...]
    variant: str
    ranks: dict[str, int]
    leads: list[str]
    says_nothing: list[str]
    submission: str
    verified: str
    training: str


class BoardTable(msgspec.Struct, frozen=True, kw_only=True):
    """Runs on one dataset that compare: protocol, table, split and sequences agree.

    Attributes:
        dataset: Name of the dataset.
        title: Title for readers; holds the word "synthetic" where the data are.
        benchmark: Name of the benchmark.
        synthetic: Whether the data are synthetic.
        redistribution: Whether the licence lets recorded motion be passed on.
        split: Split of the table.
        digests: Digests of the ``protocol``, of the table's ``identity`` and ``content``, and of the ``selection`` of
            sequences.
        own_protocol: Name and version of a protocol of the user's own; empty for prbench's.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        chosen_sequences: Number of the chosen sequences; above ``sequences`` where the table is of those that every
            method generated.
        left_sequences_out: Methods that left chosen sequences out, with how many.
        undecided: Sentences on what the data cannot decide, and the smallest differences that they can.
        rows: The runs, sorted by condition, controls last.
    """

    dataset: str
    title: str
    benchmark: str
    synthetic: bool
    redistribution: str
    split: str
    digests: dict[str, str]
    own_protocol: str
    sequences: int
    recordings: int
    chosen_sequences: int
    left_sequences_out: tuple[str, ...]
    undecided: tuple[str, ...]
    rows: list[BoardRow]


class Board(msgspec.Struct, frozen=True, kw_only=True):
    """A leaderboard; ``--format json`` writes the same.

    Attributes:
        schema_version: Version of this shape.
        tables: One table for each dataset and way of scoring it.
        macro_means: Means over datasets, for each protocol with two datasets or more.
        notes: What was left out, and which tables must not be compared.
        signed_by: Id of the key that all runs are signed by, as ``--require-signed`` asked for; else empty.
    """

    schema_version: int = 3
    tables: list[BoardTable]
    macro_means: tuple[MacroTable, ...]
    notes: tuple[str, ...]
    signed_by: str


def as_board(leaderboard: Leaderboard) -> Board:
    """Return what a leaderboard is in JSON."""
    tables = []
    for table in leaderboard.tables:
        protocol, identity, content, split, selection = table.key
        of_entry = ("run", "record", "summary", "cost", "origin", "unverified", "unverified_cost", "declared")
        of_entry += ("submission", "verified", "training")
        rows = []
        for row in table.rows:
            own: dict[str, Any] = {name: getattr(row.entry, name) for name in of_entry}
            own |= {"mark": row.entry.summary.mark, "variant": row.variant}
            nothing = [info.id for info in table.benchmark.metrics if hides(row.entry, info)]
            rows.append(BoardRow(**own, ranks=row.ranks, leads=sorted(row.leads), says_nothing=nothing))
        same = ("dataset", "title", "synthetic", "redistribution", "sequences", "recordings")
        about: dict[str, Any] = {name: getattr(table, name) for name in same}
        about |= {"digests": {"protocol": protocol, "identity": identity, "content": content, "selection": selection}}
        about |= {"benchmark": table.benchmark.name, "split": split, "own_protocol": table.protocol}
        about |= {"chosen_sequences": table.of or table.sequences, "left_sequences_out": table.shortest}
        tables.append(BoardTable(**about, undecided=undecided_lines(table), rows=rows))
    same = {name: getattr(leaderboard, name) for name in ("notes", "signed_by")}
    return Board(tables=tables, macro_means=leaderboard.macro, **same)


def board_tables(leaderboard: Leaderboard) -> list[Table]:
    """Lay out a table a dataset, whose rows are those of the leaderboard, and a table a mean over datasets."""
    several = len({table.benchmark.name for table in leaderboard.tables}) > 1
    keys = [(table.benchmark.name, table.dataset) for table in leaderboard.tables]
    tables = []
    for table in leaderboard.tables:
        about = [part_title(table)]
        if several:
            about.append(table.benchmark.about.title.lower())
        if table.earlier_version is not None:
            about.append(f"protocol version {table.earlier_version}")
        if keys.count((table.benchmark.name, table.dataset)) > 1:
            # Two tables of one dataset differ in a digest at most, so their titles have to show digests.
            protocol, identity, content, _, chosen = (part[:8] for part in table.key)
            about.append(f"protocol {protocol}, table {identity}/{content}, chosen {chosen}")
        rows = []
        for row in table.rows:
            entry = row.entry
            words = {"condition": "control" if entry.record.method.kind == CONTROL else entry.record.condition}
            words |= {"method": _words(entry.method, entry.summary.symbols), "kind": entry.origin}
            words |= {"variant": note_of(row.variant, entry.remarks)}
            words |= {"verified": entry.unverified or entry.verified, "training": entry.training}
            costs_of_row = (Cell(metric=name, value=value) for name, value in entry.cost.items())
            rows.append(Row(text=words, cells=(*measured_cells(row, table), *costs_of_row)))
        costs = [Column(key=name, title=COSTS[name][0], digits=3 if name.endswith("seconds") else 0) for name in COSTS]
        blocks = (Block(rows=tuple(rows)),)
        columns = _columns(table.benchmark, *costs)
        if any(row.entry.submission for row in table.rows):
            columns += tuple(Column(key=key, title=title, text=True) for key, title in _SUBMITTED.items())
        notes = tuple(_legend(table))
        title = ", ".join(about)
        tables.append(Table(title=title, dataset=table.dataset, columns=columns, blocks=blocks, notes=notes))
    return tables + [_macro_table(macro, with_benchmark=several) for macro in leaderboard.macro]


def part_title(table: DatasetTable) -> str:
    """Return the data and the rules behind a table in words."""
    of = f" of {table.of} that every method here generated" if table.of else ""
    own = f", own protocol {table.protocol}" if table.protocol else ""
    counts = f"{table.sequences} sequences, {counted_units(table.recordings, table.split)}"
    return f"{table.title}, {table.dataset}: {table.split}, {counts}{of}{own}"


def _words(*parts: str) -> str:
    return " ".join(part for part in parts if part)


def _columns(benchmark: Benchmark, *further: Column) -> tuple[Column, ...]:
    """Return the columns of a board; a metric that a run lacks leaves its cell empty."""
    words = ("Condition", "Method", "Variant", "Kind")
    *first, kind = (Column(key=each.lower(), title=f"{each} (declared)", text=True) for each in words)
    return (*first, *(metric_column(info, missing="") for info in benchmark.main_metrics), *further, kind)


def _legend(table: DatasetTable) -> Iterable[str]:
    sentence = "Cost as the harness measured it on the machine of each run, batched as it was; CPU: of all threads,"
    sentence += " whatever else the machine did; memory of the device, else of the process; passes as the method"
    yield f"{sentence} declares them. A dash: not measured."
    if table.earlier_version is not None:
        present = table.benchmark.present_rules.version
        sentence = f"Scored under version {table.earlier_version} of the protocol; version {present} is the present"
        yield f"{sentence} one, and no number of the two is comparable. Run the methods again to compare them."
    yield from table_notes(table)
    # The metrics of each condition in which the data separate no two methods, and the order of the others.
    for condition in dict.fromkeys(row.entry.record.condition for row in table.rows if row.ranks):
        alike = []
        ordered = []
        for info in table.benchmark.main_metrics:
            groups: dict[int, list[str]] = {}
            for row in table.rows:
                if row.entry.record.condition == condition and info.id in row.ranks:
                    groups.setdefault(row.ranks[info.id], []).append(_words(row.entry.method, row.variant))
            if list(groups) == [1]:
                alike.append(info.title)
            elif groups:
                parts = [f"{rank}. {', '.join(names)}" for rank, names in sorted(groups.items())]
                ordered.append(f"{info.title}: {'; '.join(parts)} (methods of one group are not separated).")
        if alike:
            yield f"{condition}: the data separate no two methods in {', '.join(alike)}."
        yield from (f"{condition}, {line}" for line in ordered)
    kept = licence_note(table.title, table.redistribution)
    if kept:
        yield kept


def licence_note(title: str, redistribution: str) -> str:
    """Return what the licence of a dataset keeps from boards; empty where it keeps nothing.

    Args:
        title: Title of the dataset.
        redistribution: ``yes``, ``non-commercial`` or ``none``.
    """
    left_out = "recorded motion, gaze, goals and scenes are left out; scores stand here."
    if redistribution == "yes":
        return ""
    if redistribution == "non-commercial":
        return f"{title} may be used for non-commercial purposes only: {left_out}"
    return f"{title} may not be passed on: {left_out}"


def table_notes(table: DatasetTable) -> Iterable[str]:
    """Yield what a reader of measured rows has to know, whatever stands beside them."""
    yield "Rates in %, lengths in m; 95 % intervals over recordings (of folds: over participants) in brackets."
    yield "Declared: said by the run's own files, contradicted by none, and shown by nothing but running the method."
    shown = dict.fromkeys(row.entry.method for row in table.rows if METHOD not in row.entry.declared)
    if shown:
        yield f"Made again from the table, and equal: the motions of {', '.join(shown)}."
    if table.synthetic:
        yield ON_SYNTHETIC_DATA
    if any("few_recordings" in metric.marks for row in table.rows for metric in row.entry.summary.metrics):
        yield f"{_FEW} few recordings (below ten): the interval says little."
    if table.of:
        sentence = f"Sequences of {table.of} that are longer than a method can generate are left out for all:"
        yield f"{sentence} {', '.join(table.shortest)}."
    if table.protocol:
        yield f"Scored under a protocol of the user's own, {table.protocol}: no number here is the study's."
    if table.sequences < FEWEST_RANKED:
        yield f"Nothing is ranked: fewer than {FEWEST_RANKED} sequences."
    elif any(row.ranks for row in table.rows):
        told = "Bold: better than every other method under its condition, each by a difference that the data support"
        yield f"{told} (Holm's correction for all pairs and metrics of the condition); controls are not ranked."
    yield from undecided_lines(table)
    for row in table.rows:
        # Remarks stand under the table, because a cell has no room for a sentence.
        if row.entry.summary.mark:
            yield f"{row.entry.method} {row.entry.summary.mark}."
        if row.entry.summary.arrival:
            yield f"{row.entry.method} {row.entry.summary.arrival} (docs/specification/metrics.md#prime-success)."
        if row.entry.summary.own_first_frame:
            yield f"{row.entry.method} {row.entry.summary.own_first_frame} (docs/specification/metrics.md#plausible)."
        if row.entry.summary.unsupported:
            sentence = f"{row.entry.method}: {row.entry.summary.unsupported} sequences are longer than it can generate"
            yield f"{sentence} and were left out; not ranked."
    for reason in dict.fromkeys(row.entry.unverified for row in table.rows if row.entry.unverified):
        yield f"Unverified: scores that were not held against the motions, because {reason}."
    for entry in (row.entry for row in table.rows if row.entry.unverified_cost):
        yield f"Unverified (cost): {entry.method}, {entry.run}, cost.json: {entry.unverified_cost}."


def _macro_table(macro: MacroTable, *, with_benchmark: bool) -> Table:
    benchmark = load_benchmark(macro.benchmark)
    word = " (synthetic data among them)" if macro.synthetic else ""
    title = f"Mean over datasets: {', '.join(macro.datasets)}{word}"
    if with_benchmark:
        title += f", {benchmark.about.title.lower()}"
    if macro.earlier_version is not None:
        title += f", protocol version {macro.earlier_version}"
    rows = []
    for row, cells in zip(macro.rows, _macro_cells(macro, benchmark)):
        words = {"condition": "control" if row.is_control else row.condition, "training": row.training}
        words |= {"method": _words(row.method, row.symbols), "kind": row.origin, "missing": ", ".join(row.missing)}
        words |= {"variant": note_of(row.variant, "unverified" if row.unverified else "")}
        rows.append(Row(text=words, cells=cells))
    legend = "Every dataset counts alike; in brackets the 95 % interval of the mean. In parentheses: one more than the"
    legend += " number of methods of its condition that are better on every dataset by a supported difference; none for"
    legend += " methods without a dataset."
    columns = _columns(benchmark, Column(key="missing", title="Missing", text=True))
    notes = (legend, ON_SYNTHETIC_DATA) if macro.synthetic else (legend,)
    return Table(title=title, columns=columns, blocks=(Block(rows=tuple(rows)),), notes=notes)


def _macro_cells(macro: MacroTable, benchmark: Benchmark) -> Iterator[tuple[Cell, ...]]:
    """Yield the means of each row; a metric of which another has a mean, but the row has none, is a dash."""
    for row in macro.rows:
        cells = []
        for info in benchmark.main_metrics if row.means else ():
            found = row.means.get(info.id)
            bounds = (None, None, None) if found is None else (found.mean, found.low, found.high)
            rank = row.ranks.get(info.id)
            mark = "" if rank is None else f"({rank})"
            cells.append(metric_cell(info.id, info.unit, *bounds, rank=rank, mark=mark))
        yield tuple(cells)
