"""Tables 2, S3 and S1: methods on the test sequences of each dataset, a part for each dataset.

The rows come from finished run folders, whose scores are held against their motions (``leaderboard.collect_runs``).
Rows that do not compare stand in tables of their own, as on a leaderboard. Nothing is bold here: which differences the
data support is the leaderboard's to say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from prbench.board.tables import DatasetTable, Leaderboard, TableRow, hides, undecided_lines
from prbench.harness.run_folder.record import CONTROL
from prbench.metrics import MAIN_METRICS, METRICS, MetricInfo, exported_unit
from prbench.protocol.published import (
    PublishedNumber,
    load_assumptions,
    load_published,
    load_table_one,
    published_table,
)
from prbench_benchmarks.prime_and_reach.study.beside import (
    PER_DATASET,
    Difference,
    differences,
    published_variant,
    why_not_beside,
)
from prbench_benchmarks.prime_and_reach.study.document import (
    DASH,
    MEASURED,
    SYNTHETIC,
    StudyBlock,
    StudyTable,
    StudyValue,
    interval_text,
)
from prbench_benchmarks.prime_and_reach.study.sizes import SYNTHETIC_NOTE
from prbench_benchmarks.prime_and_reach.table_two.layout import metric_title
from prbench_benchmarks.prime_and_reach.table_two.request import Row, load_table_two

_INFOS = {info.id: info for info in METRICS}
_INTERVALS = "Rates in %, Goal MPJPE and MPJPE in m; 95 % intervals over recordings in brackets."
_PUBLISHED_INTERVALS = (
    "Intervals of differences: the measured number's by recordings; a published rate's as if its sequences were"
    " independent; a published length counts as exact."
)
_SUFFIXES = {"-egoallo": "EgoAllo poses", "-mocap": "mocap poses"}
"""Ends of the names of weights in Table S1, and what they were trained on."""
_ESTIMATED = "egoallo"
"""Pose source of bodies that were estimated from what the wearer's glasses saw."""


def methods_table(board: Leaderboard, number: str, *, with_published: bool) -> list[StudyTable]:
    """Make Table 2 or Table S3, one part for each dataset and way of scoring.

    Args:
        board: Of finished runs.
        number: ``2`` for one model for all datasets, ``S3`` for a model for each.
        with_published: Show the study's rows in a block of their own and, on real recordings, the differences.
    """
    return [_part(table, number, with_published=with_published) for table in board.tables]


def poses_table(
    board: Leaderboard, pose_sources: Callable[[DatasetTable], Sequence[str]], *, with_published: bool
) -> list[StudyTable]:
    """Make Table S1: runs by the poses that they were trained and tested on.

    Args:
        board: Of finished runs of P&R on tables of one recording and two pose sources.
        pose_sources: Gives the pose sources of a table of runs; empty where the table is not at hand.
        with_published: Show the study's rows in a block of their own.
    """
    parts = []
    for table in board.tables:
        sources = pose_sources(table)
        tested = "unknown poses"
        if sources:
            tested = "EgoAllo poses" if _ESTIMATED in sources else "mocap poses"
        blocks = [
            StudyBlock(
                measured_title(table),
                tuple(
                    _line(row, row.entry.record.condition, f"{row.entry.method}, {_trained_on(row)}")
                    for row in table.rows
                ),
            )
        ]
        values = [
            replace(value, variant=f"{_trained_on(row)}; tested on {tested}")
            for row in table.rows
            for value in measured_values(row, table)
        ]
        if with_published:
            numbers = [each for each in load_published("S1") if each.variant.endswith(f"tested on {tested}")]
            rows = _published_rows(numbers, lambda each: each.variant.partition(";")[0])
            blocks.append(StudyBlock(_published_title("S1", "adt", table), rows))
            values += [published_value(number) for number in numbers]
        parts.append(
            StudyTable(
                number="S1",
                title=published_table("S1").title,
                dataset=table.dataset,
                part=f"{table.dataset}, tested on {tested}",
                header=_header(),
                blocks=tuple(block for block in blocks if block.rows),
                values=tuple(values),
                text_columns=2,
                notes=(
                    "What a model was trained on follows from the name of its weights: it ends in -egoallo or -mocap.",
                    *_notes(table, "S1", ()),
                ),
            )
        )
    return parts


def _part(table: DatasetTable, number: str, *, with_published: bool) -> StudyTable:
    """Make one dataset's part."""
    placed, others = _placed(table, number)
    lines = [
        _line(row, _condition_title(study.condition.value), _study_label(study, row, placed)) for study, row in placed
    ]
    blocks = [StudyBlock(measured_title(table), tuple(lines))]
    beside = tuple(_line(row, _shown_condition(row), _label(row)) for row in others)
    blocks.append(StudyBlock("Beside the study's rows: controls, and methods or weights that it does not have", beside))
    values = [value for _, row in placed for value in measured_values(row, table)]
    values += [value for row in others for value in measured_values(row, table)]
    found: tuple[Difference, ...] = ()
    if with_published:
        dataset = table.dataset.removeprefix("synthetic-")
        numbers = [each for each in load_published(number) if each.dataset == dataset]
        blocks.append(StudyBlock(_published_title(number, dataset, table), _published_rows(numbers, _published_label)))
        values += [published_value(each) for each in numbers]
        found = differences([row for _, row in placed], number)
        blocks.append(StudyBlock("Measured minus published", _difference_rows(found)))
        values += [_difference_value(each) for each in found]
    return StudyTable(
        number=number,
        title=published_table(number).title,
        dataset=table.dataset,
        part=part_title(table),
        header=_header(),
        blocks=tuple(block for block in blocks if block.rows),
        values=tuple(values),
        text_columns=2,
        notes=tuple(_notes(table, number, found)),
    )


def _placed(table: DatasetTable, number: str) -> tuple[list[tuple[Row, TableRow]], list[TableRow]]:
    """Return runs in the study's places, in its order, and all other runs."""
    placed: list[tuple[Row, TableRow]] = []
    taken: set[str] = set()
    for study in load_table_two().rows:
        for row in table.rows:
            if row.entry.run not in taken and _stands_for(row, study, number):
                placed.append((study, row))
                taken.add(row.entry.run)
    return placed, [row for row in table.rows if row.entry.run not in taken]


def _stands_for(row: TableRow, study: Row, number: str) -> bool:
    """Return True if a run is of this row of the study; other weights than the study's have to be bundled ones."""
    entry = row.entry
    if (entry.method, entry.record.condition) != (study.method, study.condition.value):
        return False
    named = published_variant(entry, number)
    if named is None or named[1].startswith("what its weights"):
        return False
    variant = load_table_two().weights[study.weights].variant
    return named[0] == (PER_DATASET if number == "S3" and variant == "fine-tuned" else variant)


def _study_label(study: Row, row: TableRow, placed: Sequence[tuple[Row, TableRow]]) -> str:
    """Return the study's label, with what tells runs apart where several stand for one row or options were given."""
    several = sum(other == study for other, _ in placed) > 1
    options = dict(row.entry.record.method.options)
    if several:
        return f"{study.label} ({row.variant})"
    if options:
        return f"{study.label} ({', '.join(f'{key}={value}' for key, value in sorted(options.items()))})"
    return study.label


def _header() -> tuple[str, ...]:
    return ("Condition", "Method", *(metric_title(info) for info in MAIN_METRICS))


def _line(row: TableRow, condition: str, label: str) -> tuple[str, ...]:
    marks = [part for part in (row.entry.summary.symbols, "unverified" if row.entry.unverified else "") if part]
    shown = f"{label} ({', '.join(marks)})" if marks else label
    return (condition, shown, *measured_cells(row))


def measured_cells(row: TableRow) -> tuple[str, ...]:
    """Return the main metrics of a run with their intervals, as printed."""
    return tuple(_cell(row, info) for info in MAIN_METRICS)


def _cell(row: TableRow, info: MetricInfo) -> str:
    metric = row.entry.metric(info.id)
    if metric is None or hides(row.entry, info):
        return DASH
    low, high = (None if bound is None else info.scale * bound for bound in (metric.low, metric.high))
    return interval_text(info.scale * metric.mean, low, high)


def measured_values(row: TableRow, table: DatasetTable) -> Iterable[StudyValue]:
    """Yield all metrics of a run, in printed units."""
    for metric in row.entry.summary.metrics:
        info = _INFOS.get(metric.metric)
        if info is None:
            continue
        hidden = hides(row.entry, info)
        notes = [
            *metric.marks,
            f"common {table.sequences} of {table.of} sequences" if table.of else "",
            f"own protocol {table.protocol}" if table.protocol else "",
            row.entry.mark,
            f"unverified: {row.entry.unverified}" if row.entry.unverified else "",
        ]
        yield StudyValue(
            dataset=table.dataset,
            condition=row.entry.record.condition,
            method=row.entry.method,
            variant=row.variant,
            metric=metric.metric,
            value=None if hidden else info.scale * metric.mean,
            low=None if hidden or metric.low is None else info.scale * metric.low,
            high=None if hidden or metric.high is None else info.scale * metric.high,
            unit=exported_unit(info.unit),
            sequences=metric.sequences,
            recordings=metric.recordings,
            detectable=None if hidden or metric.detectable is None else info.scale * metric.detectable,
            origin=SYNTHETIC if table.synthetic else MEASURED,
            note="; ".join(part for part in notes if part),
        )


def _published_rows(
    numbers: Sequence[PublishedNumber], label: Callable[[PublishedNumber], str]
) -> tuple[tuple[str, ...], ...]:
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for number in numbers:
        key = (_condition_title(number.condition), label(number))
        cells.setdefault(key, {})[number.metric] = number.printed or DASH
    return tuple((*key, *(found.get(info.id, DASH) for info in MAIN_METRICS)) for key, found in cells.items())


def _published_label(number: PublishedNumber) -> str:
    """Return the study's own label of a row."""
    table = load_table_two()
    for row in table.rows:
        variant = table.weights[row.weights].variant
        if number.table == "S3" and variant == "fine-tuned":
            variant = PER_DATASET
        if (row.method, row.condition.value, variant) == (number.method, number.condition, number.variant):
            return row.label
    return f"{number.method}, {number.variant}"


def published_value(number: PublishedNumber) -> StudyValue:
    """Return a published cell as a row of the table's CSV."""
    return StudyValue(
        dataset=number.dataset,
        condition=number.condition,
        method=number.method,
        variant=number.variant,
        metric=number.metric,
        value=number.value,
        unit=exported_unit(_INFOS[number.metric].unit),
        sequences=load_table_one()[number.dataset].test,
        origin=number.source,
        note=number.note,
    )


def _difference_rows(found: Sequence[Difference]) -> tuple[tuple[str, ...], ...]:
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for one in found:
        mark = "" if one.verified else " (unverified)"
        key = (_condition_title(one.condition), f"{one.method}, {one.published_variant}{mark}")
        rows.setdefault(key, {})[one.metric] = interval_text(one.difference, one.low, one.high, sign=True)
    return tuple((*key, *(cells.get(info.id, DASH) for info in MAIN_METRICS)) for key, cells in rows.items())


def _difference_value(one: Difference) -> StudyValue:
    return StudyValue(
        dataset=one.dataset,
        condition=one.condition,
        method=one.method,
        variant=one.published_variant,
        metric=one.metric,
        value=one.difference,
        low=one.low,
        high=one.high,
        unit=one.unit,
        sequences=one.sequences,
        origin=f"measured - {one.source}",
        note="; ".join(("assumptions: " + ", ".join(one.assumptions), *one.remarks)),
    )


def part_title(table: DatasetTable) -> str:
    """Return the data and the rules behind a part in words."""
    of = f" (of {table.of}: those that every method generated)" if table.of else ""
    own = f", own protocol {table.protocol}" if table.protocol else ""
    return f"{table.title} ({table.dataset}), {table.sequences} sequences{of} of {table.recordings} recordings{own}"


def measured_title(table: DatasetTable) -> str:
    """Return the title of a block of measured rows."""
    if table.synthetic:
        return "Measured on synthetic data: not comparable with published numbers"
    if table.protocol:
        return f"Measured under the own protocol {table.protocol}: not comparable with published numbers"
    return "Measured"


def _published_title(number: str, dataset: str, table: DatasetTable) -> str:
    base = f"Published: Prime and Reach, Table {number}, {dataset}"
    return f"{base}: of real people, not comparable with the synthetic ones above" if table.synthetic else base


def table_notes(table: DatasetTable) -> Iterable[str]:
    """Yield what a reader of measured rows has to know, whatever stands beside them."""
    yield _INTERVALS
    if table.protocol:
        yield f"Scored under a protocol of the user's own, {table.protocol}: no measured number here is the study's."
    if table.of:
        yield (
            f"Of {table.of} sequences, those that every method generated; longer ones than a method can generate are"
            f" left out for all: {', '.join(table.shortest)}."
        )
    if table.synthetic:
        yield SYNTHETIC_NOTE
    yield from undecided_lines(table)
    for row in table.rows:
        if row.entry.mark:
            yield f"{row.entry.method} {row.entry.mark}."
        if row.entry.summary.edge_arrivals:
            yield f"{row.entry.method}: {row.entry.summary.edge_arrivals}."
        if row.entry.unverified:
            yield f"{row.entry.method} ({row.entry.run}): unverified, because {row.entry.unverified}."


def _notes(table: DatasetTable, number: str, found: Sequence[Difference]) -> Iterable[str]:
    yield from table_notes(table)
    for row in table.rows:
        named = published_variant(row.entry, number) if number in ("2", "S3") else None
        if named is not None and named[1]:
            yield f"{row.entry.method} ({row.variant}): {named[1]}."
    if not found:
        reasons = dict.fromkeys(why_not_beside(row.entry) for row in table.rows)
        for reason in filter(None, reasons):
            yield f"No difference to a published number for {reason}."
        return
    yield _PUBLISHED_INTERVALS
    yield from dict.fromkeys(f"{one.method}: {remark}" for one in found for remark in one.remarks)
    named = {name for one in found for name in one.assumptions}
    for each in load_assumptions():
        if each.id in named:
            titles = ", ".join(_INFOS[metric].title for metric in each.metrics)
            yield f"Could explain a difference in {titles}: {each.text}"
    yield from published_table(number).notes


def _condition_title(condition: str) -> str:
    titles = {block.condition.value: block.title for block in load_table_two().blocks}
    return titles.get(condition, condition)


def _shown_condition(row: TableRow) -> str:
    is_control = row.entry.record.method.kind == CONTROL
    return "control" if is_control else _condition_title(row.entry.record.condition)


def _label(row: TableRow) -> str:
    return f"{row.entry.method} ({row.variant})" if row.variant else row.entry.method


def _trained_on(row: TableRow) -> str:
    weights = (row.entry.record.method.weights or "").removesuffix(".safetensors")
    for suffix, poses in _SUFFIXES.items():
        if weights.endswith(suffix):
            return f"trained on {poses}"
    return f"trained on unknown poses ({weights or 'no weights'})"
