"""Tables 1 and S2: how many sequences there are, how long they are, and how far people move."""

from __future__ import annotations

from collections.abc import Sequence

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.protocol.published import DATASETS, QUANTITIES, Spread, cite, load_table_one, published_table
from prbench.sequences import SequenceTable
from prbench.sequences.table import TableStatistics, table_statistics
from prbench_benchmarks.prime_and_reach.study.document import (
    DASH,
    MEASURED,
    SYNTHETIC,
    StudyBlock,
    StudyTable,
    StudyValue,
)

_TITLES = {
    "duration": "Duration (s)",
    "prime_gap": "Prime gap (s)",
    "body_movement": "Body movement (m)",
    "hand_movement": "Hand movement (m)",
}
SYNTHETIC_NOTE = "Numbers of synthetic data say nothing about real people; never compare them with published ones."


def table_one(tables: Sequence[SequenceTable]) -> StudyTable:
    """Make Table 1: numbers of sequences, and four quantities as mean ± standard deviation over sequences."""
    statistics = [table_statistics(table) for table in tables]
    header = ("Dataset", "Body pose", "Sequences", *_TITLES.values())
    measured = tuple(
        (each.dataset, ", ".join(each.pose_sources), str(each.sequences), *_measured_spreads(each))
        for each in statistics
    )
    names = _published_names(tables)
    published = tuple((name, "", str(load_table_one()[name].sequences), *_published_spreads(name)) for name in names)
    values = [value for table, each in zip(tables, statistics) for value in _measured_values(table, each)]
    values += [value for name in names for value in _published_values(name)]
    return StudyTable(
        number="1",
        title=published_table("1").title,
        header=header,
        blocks=_blocks("1", tables, measured, published),
        values=tuple(values),
        text_columns=2,
        notes=(
            "Mean ± standard deviation over sequences.",
            *published_table("1").notes,
            *_synthetic_notes(tables),
        ),
    )


def table_s2(tables: Sequence[SequenceTable]) -> StudyTable:
    """Make Table S2: sequences of each split, beside the recordings that they come from.

    The study has no validation split: sequences of ours stand in a column of their own.
    """
    measured = []
    values = []
    for table in tables:
        rows = table.scalars()
        splits = rows["split"].to_pylist()
        recordings = rows["recording_id"].to_pylist()
        counts = {split: splits.count(split) for split in ("train", "validation", "test")}
        cells = []
        for split, count in counts.items():
            held = len({name for name, of in zip(recordings, splits) if of == split})
            cells.append(f"{count} ({held})")
            values.append(_count(table, split, count, recordings=held))
        values.append(_count(table, "total", len(splits), recordings=len(set(recordings))))
        measured.append((table.info.dataset, *cells, f"{len(splits)} ({len(set(recordings))})"))
    published = []
    for name in _published_names(tables):
        row = load_table_one()[name]
        published.append((name, str(row.train), DASH, str(row.test), str(row.sequences)))
        source = f"published: {cite('S2')}"
        for split, count in (("train", row.train), ("test", row.test), ("total", row.sequences)):
            values.append(
                StudyValue(
                    dataset=name, variant=split, metric="n_sequences", value=float(count), unit="", origin=source
                )
            )
    return StudyTable(
        number="S2",
        title=published_table("S2").title,
        header=("Dataset", "Train", "Validation", "Test", "Total"),
        blocks=_blocks("S2", tables, tuple(measured), tuple(published)),
        values=tuple(values),
        notes=(
            "Recordings in parentheses. The study has no validation split; ours is a part of its training split.",
            *published_table("S2").notes,
            *_synthetic_notes(tables),
        ),
    )


def origin_of(table: SequenceTable) -> str:
    """Return the word for where the numbers of a table come from."""
    return SYNTHETIC if table.info.synthetic else MEASURED


def _published_names(tables: Sequence[SequenceTable]) -> list[str]:
    """Return the study's datasets that stand beside these tables, in its order."""
    shown = {table.info.dataset.removeprefix(SYNTHETIC_PREFIX) for table in tables}
    return [name for name in DATASETS if name in shown]


def _blocks(
    number: str,
    tables: Sequence[SequenceTable],
    measured: tuple[tuple[str, ...], ...],
    published: tuple[tuple[str, ...], ...],
) -> tuple[StudyBlock, ...]:
    """Put measured, synthetic and published rows into blocks of their own."""
    real = tuple(row for table, row in zip(tables, measured, strict=True) if not table.info.synthetic)
    made_up = tuple(row for table, row in zip(tables, measured, strict=True) if table.info.synthetic)
    blocks = [
        StudyBlock("Measured on recordings of people", real),
        StudyBlock("Measured on synthetic data: not comparable with published numbers", made_up),
        StudyBlock(f"Published: {cite(number)}", published),
    ]
    return tuple(block for block in blocks if block.rows)


def _synthetic_notes(tables: Sequence[SequenceTable]) -> tuple[str, ...]:
    return (SYNTHETIC_NOTE,) if any(table.info.synthetic for table in tables) else ()


def _measured_spreads(each: TableStatistics) -> tuple[str, ...]:
    if not each.sequences:
        return (DASH,) * len(_TITLES)
    return tuple(_spread(each.spread(name)) for name in _TITLES)


def _published_spreads(name: str) -> tuple[str, ...]:
    return tuple(_spread(getattr(load_table_one()[name], quantity)) for quantity in _TITLES)


def _spread(spread: Spread) -> str:
    return f"{spread.mean:.2f} ± {spread.sd:.2f}"


def _measured_values(table: SequenceTable, each: TableStatistics) -> list[StudyValue]:
    recordings = len(set(table.scalars()["recording_id"].to_pylist()))
    values = [_count(table, "total", each.sequences, recordings=recordings)]
    for name, unit in QUANTITIES.items():
        spread = each.spread(name) if each.sequences else None
        values.append(
            StudyValue(
                dataset=each.dataset,
                metric=name,
                value=None if spread is None else spread.mean,
                sd=None if spread is None else spread.sd,
                unit=unit,
                sequences=each.sequences,
                recordings=recordings,
                origin=origin_of(table),
            )
        )
    return values


def _published_values(name: str) -> list[StudyValue]:
    row = load_table_one()[name]
    source = f"published: {cite('1')}"
    values = [StudyValue(dataset=name, metric="n_sequences", value=float(row.sequences), unit="", origin=source)]
    for quantity, unit in QUANTITIES.items():
        spread = getattr(row, quantity)
        values.append(
            StudyValue(
                dataset=name, metric=quantity, value=spread.mean, sd=spread.sd, unit=unit, sequences=row.sequences,
                origin=source,
            )
        )  # fmt: skip
    return values


def _count(table: SequenceTable, variant: str, count: int, *, recordings: int) -> StudyValue:
    return StudyValue(
        dataset=table.info.dataset,
        variant=variant,
        metric="n_sequences",
        value=float(count),
        unit="",
        recordings=recordings,
        origin=origin_of(table),
    )
