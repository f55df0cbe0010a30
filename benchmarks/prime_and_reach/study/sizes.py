"""Tables 1 and S2: how many sequences there are, how long they are, and how far people move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from prbench.datasets import ON_SYNTHETIC_DATA, SYNTHETIC_PREFIX
from prbench.protocol.published import DATASETS, QUANTITIES, cite, load_table_one, published_table
from prbench.sequences import SequenceTable
from prbench.sequences.table import table_statistics
from prbench.tables import Block, Cell, Column, Row, Table

MEASURED = "measured"
SYNTHETIC = "measured on synthetic data"
Tables = Sequence[SequenceTable]
_SPLITS = ("train", "validation", "test")


def sizes(tables: Sequence[SequenceTable]) -> list[Table]:
    """Make both tables, for commands that build tables."""
    return [table_one(tables), table_s2(tables)]


def table_one(tables: Sequence[SequenceTable]) -> Table:
    """Make Table 1: numbers of sequences, and four quantities as mean ± standard deviation over sequences."""
    measured = []
    for table in tables:
        each = table_statistics(table)
        recordings = len(set(table.scalars()["recording_id"].to_pylist()))
        about: dict[str, Any] = {"dataset": each.dataset, "recordings": recordings}
        about["origin"] = origin_of(synthetic=table.info.synthetic)
        cells = [Cell(metric="n_sequences", variant="total", value=float(each.sequences), **about)]
        for name, unit in QUANTITIES.items():
            spread = each.spread(name) if each.sequences else None
            value, sd = (None, None) if spread is None else (spread.mean, spread.sd)
            cells.append(Cell(metric=name, value=value, sd=sd, unit=unit, sequences=each.sequences, **about))
        words = {"dataset": each.dataset, "poses": ", ".join(each.pose_sources)}
        measured.append(Row(text=words, cells=tuple(cells)))
    published = []
    for name in _published_names(tables):
        row = load_table_one()[name]
        about: dict[str, Any] = {"dataset": name, "origin": f"published: {cite('1')}"}
        cells = [Cell(metric="n_sequences", value=float(row.sequences), **about)]
        for quantity, unit in QUANTITIES.items():
            spread = getattr(row, quantity)
            told = {"value": spread.mean, "sd": spread.sd, "unit": unit, "sequences": row.sequences}
            cells.append(Cell(metric=quantity, **told, **about))
        published.append(Row(text={"dataset": name}, cells=tuple(cells)))
    columns = (
        Column(key="dataset", title="Dataset", text=True),
        Column(key="poses", title="Body pose", text=True),
        Column(key="n_sequences", title="Sequences", digits=0),
        *(Column(key=name, title=name.replace("_", " ").capitalize(), unit=unit) for name, unit in QUANTITIES.items()),
    )
    return _table("1", tables, columns, measured, published, "Mean ± standard deviation over sequences.")


def table_s2(tables: Sequence[SequenceTable]) -> Table:
    """Make Table S2: sequences of each split, beside the recordings that they come from.

    The study has no validation split: sequences of ours stand in a column of their own.
    """
    measured = []
    for table in tables:
        rows = table.scalars()
        pairs = list(zip(rows["split"].to_pylist(), rows["recording_id"].to_pylist()))
        words = {"dataset": table.info.dataset}
        cells = []
        for split in (*_SPLITS, "total"):
            held = [recording for own, recording in pairs if split in (own, "total")]
            recordings = len(set(held))
            words[split] = f"{len(held)} ({recordings})"
            about: dict[str, Any] = {"recordings": recordings, "origin": origin_of(synthetic=table.info.synthetic)}
            value = float(len(held))
            cells.append(Cell(dataset=table.info.dataset, variant=split, metric="n_sequences", value=value, **about))
        measured.append(Row(text=words, cells=tuple(cells)))
    published = []
    for name in _published_names(tables):
        row = load_table_one()[name]
        counts = {"train": row.train, "test": row.test, "total": row.sequences}
        about: dict[str, Any] = {"dataset": name, "metric": "n_sequences", "origin": f"published: {cite('S2')}"}
        cells = tuple(Cell(variant=split, value=float(count), **about) for split, count in counts.items())
        words = {"dataset": name} | {split: str(count) for split, count in counts.items()}
        published.append(Row(text=words, cells=cells))
    columns = (
        Column(key="dataset", title="Dataset", text=True),
        *(Column(key=split, title=split.capitalize()) for split in (*_SPLITS, "total")),
    )
    note = "Recordings in parentheses. The study has no validation split; ours is a part of its training split."
    return _table("S2", tables, columns, measured, published, note)


def origin_of(*, synthetic: bool) -> str:
    """Return the word for where measured numbers come from."""
    return SYNTHETIC if synthetic else MEASURED


def _published_names(tables: Sequence[SequenceTable]) -> list[str]:
    """Return the study's datasets that stand beside these tables, in its order."""
    shown = {table.info.dataset.removeprefix(SYNTHETIC_PREFIX) for table in tables}
    return [name for name in DATASETS if name in shown]


def _table(
    number: str, tables: Tables, columns: tuple[Column, ...], measured: list[Row], published: list[Row], note: str
) -> Table:
    """Put measured, synthetic and published rows into blocks of their own."""
    pairs = list(zip(tables, measured, strict=True))
    recorded = tuple(row for table, row in pairs if not table.info.synthetic)
    made_up = tuple(row for table, row in pairs if table.info.synthetic)
    return Table(
        number=number,
        title=published_table(number).title,
        columns=columns,
        blocks=(
            Block(title="Measured on recordings of people", rows=recorded),
            Block(title="Measured on synthetic data: not comparable with published numbers", rows=made_up),
            Block(title=f"Published: {cite(number)}", rows=tuple(published)),
        ),
        notes=(note, *published_table(number).notes, *([ON_SYNTHETIC_DATA] if made_up else [])),
    )
