"""Tables 2, S3 and S1: methods on the test sequences of each dataset, a part for each dataset.

The rows come from finished run folders, whose scores are held against their motions (``leaderboard.collect_runs``).
Rows that do not compare stand in tables of their own, as on a leaderboard.

A published number stands only beside a built-in method of the same name under the same condition, run on the test split
of a table of real recordings. Everything else has no difference: synthetic people are not the study's people.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import hypot
from typing import Any

from msgspec.structs import replace
from scipy.stats import binomtest

from prbench.board.collect import LeaderboardRow
from prbench.board.export import measured_cells, part_title, table_notes
from prbench.board.tables import DatasetTable, Leaderboard, TableRow, hides
from prbench.harness.run_folder.record import BUILT_IN, CONTROL
from prbench.metrics import MAIN_METRICS, METRICS, exported_unit
from prbench.protocol.published import (
    DATASETS,
    PublishedNumber,
    assumptions_for,
    load_assumptions,
    load_published,
    load_table_one,
    published_table,
)
from prbench.tables import DASH, Block, Cell, Column, Row, Table, metric_column, note_of
from prbench_benchmarks.prime_and_reach.study.sizes import origin_of
from prbench_benchmarks.prime_and_reach.table_two.request import StudyRow, load_table_two, study_place

_INFOS = {info.id: info for info in METRICS}
# Columns of the main metrics as the study prints them.
METRIC_COLUMNS = tuple(metric_column(info, in_study=True, with_unit=False) for info in MAIN_METRICS)
CONDITION_COLUMN = Column(key="condition", title="Condition", text=True)
_COLUMNS = (CONDITION_COLUMN, Column(key="method", title="Method", text=True), *METRIC_COLUMNS)
# What a published number and its cell share.
_ABOUT = ("dataset", "condition", "method", "variant", "metric")
_DIFFERENCES = (
    "Intervals of differences: the measured number's by recordings; a published rate's as if its sequences were"
    " independent; a published length counts as exact."
)
_MARKS = "†: zero-shot; ‡: zero-shot, trained on HumanML3D; *: zero-shot, trained on Nymeria; no mark: fine-tuned."
_STANDS_IN = "small bundled weights, trained on synthetic people alone, stand in for the study's"
_UNKNOWN_WEIGHTS = "what its weights were trained on is not known; compared with the study's fine-tuned row"
_FINE_TUNED = "fine-tuned"
_PER_DATASET = "fine-tuned per dataset"
# Ends of the names of weights in Table S1, and what they were trained on.
_SUFFIXES = {"-egoallo": "EgoAllo poses", "-mocap": "mocap poses"}
# Pose source of bodies that were estimated from what the wearer's glasses saw.
_ESTIMATED = "egoallo"


def methods_table(board: Leaderboard, number: str, *, with_published: bool, named: bool = False) -> list[Table]:
    """Make Table 2 or Table S3, one part for each dataset and way of scoring, in the study's order.

    Args:
        board: Board of finished runs.
        number: ``2`` for one model for all datasets, ``S3`` for a model for each.
        with_published: Show the study's rows in a block of their own and, on real recordings, the differences.
        named: Each run stands for the row of the study after which its folder is named, whatever its weights are.
    """
    tables = sorted(board.tables, key=lambda table: study_place(table.dataset))
    return [_part(table, number, with_published=with_published, named=named) for table in tables]


def poses_table(
    board: Leaderboard, pose_sources: Callable[[DatasetTable], Sequence[str]], *, with_published: bool
) -> list[Table]:
    """Make Table S1: runs by the poses that they were trained and tested on.

    Args:
        board: Board of finished runs of P&R on tables of one recording and two pose sources.
        pose_sources: Gives the pose sources of a table of runs; empty where the table is not at hand.
        with_published: Show the study's rows in a block of their own.
    """
    parts = []
    for table in board.tables:
        sources = pose_sources(table)
        tested = "unknown poses"
        if sources:
            tested = "EgoAllo poses" if _ESTIMATED in sources else "mocap poses"
        rows = []
        for row in table.rows:
            weights = (row.entry.record.method.weights or "").removesuffix(".safetensors")
            known = (poses for suffix, poses in _SUFFIXES.items() if weights.endswith(suffix))
            trained = f"trained on {next(known, '')}"
            if trained == "trained on ":
                trained = f"trained on unknown poses ({weights or 'no weights'})"
            label = f"{row.entry.method}, {trained}"
            variant = f"{trained}; tested on {tested}"
            rows.append(measured_row(row, table, row.entry.record.condition, label, variant=variant))
        blocks = [Block(title=measured_title(table), rows=tuple(rows))]
        if with_published:
            numbers = [each for each in load_published("S1") if each.variant.endswith(f"tested on {tested}")]
            published = published_rows(numbers, lambda each: each.variant.partition(";")[0])
            blocks.append(Block(title=_published_title("S1", "adt", table), rows=published))
        said = "What a model was trained on is declared by the name of its weights: it ends in -egoallo or -mocap."
        notes = (said, *table_notes(table), *_why_not_beside_notes(table))
        parts.append(part_of("S1", table, f"{table.dataset}, tested on {tested}", blocks, notes))
    return parts


def part_of(
    number: str, table: DatasetTable, part: str, blocks: Iterable[Block], notes: Iterable[str], **more: Any
) -> Table:
    """Return one dataset's part of a table of the study; ``more`` are other fields, or columns of its own."""
    about = {"title": published_table(number).title, "columns": _COLUMNS, "dataset": table.dataset} | more
    return Table(number=number, part=part, blocks=tuple(blocks), notes=tuple(notes), **about)


def _part(table: DatasetTable, number: str, *, with_published: bool, named: bool) -> Table:
    """Make one dataset's part."""
    # Runs in the study's places, in its order, and all other runs.
    placed: list[tuple[StudyRow, TableRow]] = []
    taken: set[str] = set()
    for study in load_table_two().rows:
        for row in table.rows:
            entry = row.entry
            stands = entry.run == study.name
            if not named:
                # Other weights than the study's have to be bundled ones.
                variant = published_variant(entry, number) or ("", _UNKNOWN_WEIGHTS)
                same = (entry.method, entry.record.condition) == (study.method, study.condition.value)
                stands = same and variant[1] != _UNKNOWN_WEIGHTS and variant[0] == _variant_in(study, number)
            if stands and entry.run not in taken:
                placed.append((study, row))
                taken.add(row.entry.run)
    rows = []
    for study, row in placed:
        # Where several runs stand for one row, or options were given, the label says what tells them apart.
        label = study.label
        options = ", ".join(f"{key}={value}" for key, value in sorted(row.entry.record.method.options.items()))
        if sum(other == study for other, _ in placed) > 1:
            label = f"{study.label} ({row.variant})"
        elif options:
            label = f"{study.label} ({options})"
        rows.append(measured_row(row, table, condition_title(study.condition.value), label))
    others = []
    for row in table.rows:
        if row.entry.run not in taken:
            is_control = row.entry.record.method.kind == CONTROL
            condition = "control" if is_control else condition_title(row.entry.record.condition)
            label = f"{row.entry.method} ({row.variant})" if row.variant else row.entry.method
            others.append(measured_row(row, table, condition, label))
    beside = "Beside the study's rows: controls, and methods or weights that it does not have"
    blocks = [Block(title=measured_title(table), rows=tuple(rows)), Block(title=beside, rows=tuple(others))]
    notes = list(table_notes(table))
    if any(study.label[-1] in "†‡*" for study, _ in placed):
        notes.append(_MARKS)
    for row in table.rows:
        variant = published_variant(row.entry, number)
        if variant is not None and variant[1]:
            notes.append(f"{row.entry.method} ({row.variant}): {variant[1]}.")
    found: list[tuple[Cell, tuple[str, ...]]] = []
    if with_published:
        dataset = table.dataset.removeprefix("synthetic-")
        numbers = [each for each in load_published(number) if each.dataset == dataset]
        published = published_rows(numbers, _published_label)
        blocks.append(Block(title=_published_title(number, dataset, table), rows=published))
        found = differences([row for _, row in placed], number)
        cells: dict[tuple[str, str], list[Cell]] = {}
        for cell, remarks in found:
            mark = " (unverified)" if any(remark.startswith("unverified") for remark in remarks) else ""
            cells.setdefault((condition_title(cell.condition), f"{cell.method}, {cell.variant}{mark}"), []).append(cell)
        rows = [Row(text={"condition": key[0], "method": key[1]}, cells=tuple(own)) for key, own in cells.items()]
        blocks.append(Block(title="Measured minus published", rows=tuple(rows), signed=True))
    if found:
        notes.append(_DIFFERENCES)
        notes += dict.fromkeys(f"{cell.method}: {remark}" for cell, remarks in found for remark in remarks)
        known = {each.id for cell, _ in found for each in assumptions_for((cell.metric,))}
        for each in load_assumptions():
            if each.id in known:
                titles = ", ".join(_INFOS[metric].title for metric in each.metrics)
                notes.append(f"Could explain a difference in {titles}: {each.text}")
        notes += published_table(number).notes
    else:
        notes += _why_not_beside_notes(table)
    return part_of(number, table, part_title(table), blocks, notes)


def _variant_in(study: StudyRow, number: str) -> str:
    """Return the variant of a row in the words of a published table."""
    variant = load_table_two().weights[study.weights].variant
    return _PER_DATASET if number == "S3" and variant == _FINE_TUNED else variant


def measured_row(
    row: TableRow, table: DatasetTable, condition: str, label: str, /, *, note: str = "", **about: Any
) -> Row:
    """Return the row of a run, with all its metrics.

    Args:
        row: The run.
        table: Table in which the run stands.
        condition: Name of the condition as printed.
        label: Name of the row as printed.
        note: Text before the notes of each cell.
        about: Other fields of each cell.
    """
    marks = ", ".join(filter(None, (row.entry.summary.symbols, "unverified" if row.entry.unverified else "")))
    unverified = f"unverified: {row.entry.unverified}" if row.entry.unverified else ""
    cells = measured_cells(row, table, origin=origin_of(synthetic=table.synthetic), **about)
    if note or unverified:
        cells = tuple(replace(cell, note=note_of(note, cell.note, unverified)) for cell in cells)
    return Row(text={"condition": condition, "method": f"{label} ({marks})" if marks else label}, cells=cells)


def published_rows(numbers: Sequence[PublishedNumber], label: Callable[[PublishedNumber], str]) -> tuple[Row, ...]:
    """Return the study's rows, with their digits as printed.

    Args:
        numbers: Published numbers in printed order.
        label: Gives the label of a number's row.
    """
    found: dict[tuple[str, str], list[PublishedNumber]] = {}
    for number in numbers:
        found.setdefault((condition_title(number.condition), label(number)), []).append(number)
    rows = []
    for (condition, name), own in found.items():
        cells = []
        for number in own:
            about = {each: getattr(number, each) for each in (*_ABOUT, "value", "note")}
            about |= {"sequences": load_table_one()[number.dataset].test, "origin": number.source}
            cells.append(Cell(unit=exported_unit(_INFOS[number.metric].unit), **about))
        printed = {number.metric: number.printed or DASH for number in own}
        rows.append(Row(text={"condition": condition, "method": name} | printed, cells=tuple(cells)))
    return tuple(rows)


def _published_label(number: PublishedNumber) -> str:
    """Return the study's own label of a row."""
    for row in load_table_two().rows:
        variant = _variant_in(row, number.table)
        if (row.method, row.condition.value, variant) == (number.method, number.condition, number.variant):
            return row.label
    return f"{number.method}, {number.variant}"


def measured_title(table: DatasetTable) -> str:
    """Return the title of a block of measured rows."""
    said = "condition, method and weights as declared"
    if table.synthetic:
        return f"Measured on synthetic data: not comparable with published numbers; {said}"
    if table.protocol:
        return f"Measured under the own protocol {table.protocol}: not comparable with published numbers; {said}"
    return f"Measured; {said}"


def _published_title(number: str, dataset: str, table: DatasetTable) -> str:
    base = f"Published: Prime and Reach, Table {number}, {dataset}"
    return f"{base}: of real people, not comparable with the synthetic ones above" if table.synthetic else base


def _why_not_beside_notes(table: DatasetTable) -> Iterable[str]:
    for reason in filter(None, dict.fromkeys(why_not_beside(row.entry) for row in table.rows)):
        yield f"No difference to a published number for {reason}."


def condition_title(condition: str) -> str:
    """Return the study's title of a condition; other words as they are."""
    return {block.condition.value: block.title for block in load_table_two().blocks}.get(condition, condition)


# Measured beside published: which run may stand where, the difference, its interval, and what could explain it.


def published_variant(entry: LeaderboardRow, table: str = "2") -> tuple[str, str] | None:
    """Return the study's variant that a run stands for, and what has to be said of that; None if it has no row.

    Args:
        entry: A run on one dataset.
        table: ``2``, or ``S3`` for weights that were trained on one dataset.
    """
    if entry.record.method.kind != BUILT_IN or entry.is_control:
        return None
    key = (entry.method, entry.record.condition)
    rows = [row for row in load_table_two().rows if (row.method, row.condition.value) == key]
    used = (entry.record.method.weights or "").removesuffix(".safetensors")
    for row in rows:
        weights = load_table_two().weights[row.weights]
        if table == "S3" and weights.variant == _FINE_TUNED:
            if used == f"{row.weights}-{entry.summary.dataset}":
                return _PER_DATASET, ""
            continue
        if weights.state == "none" or used == row.weights:
            return weights.variant, ""
        if used == row.bundled:
            return weights.variant, _STANDS_IN
    if rows and table == "2":
        return _FINE_TUNED, _UNKNOWN_WEIGHTS
    return None


def why_not_beside(entry: LeaderboardRow) -> str | None:
    """Return why no published number stands beside a run, or None if one may."""
    reasons = {
        "scores on synthetic data, or on a dataset that the study does not have": (
            entry.summary.synthetic or entry.summary.dataset not in DATASETS
        ),
        f"split '{entry.record.split}', the study scores its test split": entry.record.split != "test",
        f"a protocol of the user's own, {entry.protocol}": bool(entry.protocol),
        "its numbers on the common sequences, since those on all of them stand beside the study's": (
            entry.only is not None and not entry.table.unsupported
        ),
        "a control of the harness": entry.is_control,
        "a method that generates gaze, which the study's do not": entry.record.method.gaze,
        "motions with an option that the study has not": not entry.record.is_usual,
        "recorded motions, not a method's": entry.summary.hands_in_recordings,
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def differences(rows: Iterable[TableRow], table: str = "2") -> list[tuple[Cell, tuple[str, ...]]]:
    """Compare measured rows with the published ones.

    Args:
        rows: Rows of a leaderboard.
        table: ``2`` or ``S3``.

    Returns:
        Each difference, measured - published, with remarks on what could explain it beside the assumptions.
    """
    found = []
    for row in rows:
        named = published_variant(row.entry, table)
        if named is None or why_not_beside(row.entry) is not None:
            continue
        wanted = (row.entry.summary.dataset, row.entry.record.condition, row.entry.method, named[0])
        for number in load_published(table):
            if (number.dataset, number.condition, number.method, number.variant) == wanted:
                remarks = tuple(_remarks(row.entry, number, named[1]))
                cell = _difference(row, number, remarks)
                if cell is not None:
                    found.append((cell, remarks))
    return found


def _difference(row: TableRow, number: PublishedNumber, remarks: tuple[str, ...]) -> Cell | None:
    info = _INFOS[number.metric]
    metric = row.entry.summary.metric(number.metric)
    if metric is None or number.value is None or hides(row.entry, info):
        return None
    published = number.value
    measured = info.scale * metric.mean
    low = None
    high = None
    if metric.low is not None and metric.high is not None:
        # Bound the difference: squares of both distances to the bounds add up (MOVER, Zou and Donner 2008).
        below = published
        above = published
        if info.unit == "rate":
            theirs = load_table_one()[number.dataset].test
            wilson = binomtest(round(published / 100 * theirs), theirs).proportion_ci(method="wilson")
            below = min(published, 100 * wilson.low)
            above = max(published, 100 * wilson.high)
        low = measured - published - hypot(measured - info.scale * metric.low, above - published)
        high = measured - published + hypot(info.scale * metric.high - measured, published - below)
    assumptions = ", ".join(each.id for each in assumptions_for((number.metric,)))
    about = {each: getattr(number, each) for each in _ABOUT}
    about |= {"sequences": metric.sequences, "origin": f"measured - {number.source}"}
    about |= {"unit": exported_unit(info.unit), "note": "; ".join((f"assumptions: {assumptions}", *remarks))}
    return Cell(value=measured - published, low=low, high=high, **about)


def _remarks(entry: LeaderboardRow, number: PublishedNumber, said: str) -> Iterable[str]:
    theirs = load_table_one()[number.dataset].test
    if said:
        yield said
    if entry.summary.sequences != theirs:
        yield f"{entry.summary.sequences} test sequences, the study has {theirs}"
    if unsupported := entry.summary.unsupported or entry.table.unsupported:
        yield f"{unsupported} sequences are left out, as longer than the method can generate"
    if entry.record.samples > 1:
        yield f"{entry.record.samples} samples a sequence"
    if entry.summary.mark:
        yield entry.summary.mark
    if entry.unverified:
        yield f"unverified: {entry.unverified}"
    if number.note.startswith("inconsistent"):
        yield f"the published cell is odd: {number.note}"
