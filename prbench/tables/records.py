"""What a table is made of: columns, cells, rows, blocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal

import msgspec

from prbench.metrics.registry import MetricInfo, exported_unit, printed_unit

DASH = "–"
_ARROWS = {"": "", "higher": " ↑", "lower": " ↓"}


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One column and the format of its numbers."""

    key: str
    """Metric of the cells that stand in it, or key of the rows' words."""
    title: str
    better: Literal["", "higher", "lower"] = ""
    """Direction of the better values: an arrow behind the title."""
    unit: str = ""
    """Unit in parentheses behind the title; empty for none."""
    text: bool = False
    """Holds words: set to the left."""
    digits: int = 2
    """Digits behind the point."""
    missing: str | None = None
    """Stands where a row has neither words nor a cell: by default a dash, nothing in a column of words."""

    @property
    def heading(self) -> str:
        """Title, arrow and unit."""
        return f"{self.title}{_ARROWS[self.better]}{f' ({self.unit})' if self.unit else ''}"


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """One number of a table in its printed unit, with all that its CSV row says of it.

    Attributes:
        dataset: Name of the dataset.
        metric: Id of the metric or quantity, which is the key of its column. Cells without a column stand in CSV and
            JSON alone.
        value: Rates in %, lengths in metres, times in seconds; null where a dash is printed.
        unit: ``%``, ``m``, ``s``, ``ratio``, or empty.
        condition: What the method was given.
        method: Name of the method.
        variant: What tells two rows of one method apart.
        low: Lower bound of the 95 % interval; null without one.
        high: Upper bound of the interval.
        sd: Standard deviation over sequences, or the number after ± in the study.
        sequences: Number of sequences behind the value.
        recordings: Number of recordings that they come from.
        detectable: Smallest difference to an unrelated method of the same spread that would be found with 80 % power;
            null where nothing can be tested.
        rank: One more than the number of methods that are better by a supported difference; null where nothing is
            ranked.
        best: The number is printed bold.
        mark: Sign behind the number, such as ``†``.
        origin: ``measured``, ``measured on synthetic data``, ``published: …`` or ``measured - published: …``.
        note: What a reader of the number needs to know.
    """

    dataset: str = ""
    metric: str
    value: float | None
    unit: str = ""
    condition: str = ""
    method: str = ""
    variant: str = ""
    low: float | None = None
    high: float | None = None
    sd: float | None = None
    sequences: int | None = None
    recordings: int | None = None
    detectable: float | None = None
    rank: int | None = None
    best: bool = False
    mark: str = ""
    origin: str = "measured"
    note: str = ""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One row: words by the key of their column, and cells, each in the column of its metric."""

    text: Mapping[str, str]
    """Words as printed. Where a column of numbers has words too, these are printed in place of the cell's number."""
    cells: tuple[Cell, ...] = ()


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rows of one origin: measured and published ones never stand in the same block."""

    title: str = ""
    """Says where the numbers come from; empty in a table of one block."""
    rows: tuple[Row, ...]
    signed: bool = False
    """The numbers are differences: their signs are printed."""


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table, or what a figure draws. Declared in TOML it has no blocks yet."""

    number: str = ""
    """Number in the study, such as ``2`` or ``S3``; empty for a table that no study has."""
    title: str = ""
    columns: tuple[Column, ...] = ()
    blocks: tuple[Block, ...] = ()
    dataset: str = ""
    """Dataset of one part of a table that has several."""
    part: str = ""
    """The part in words: dataset, and how much data stand behind it."""
    stamp: str = ""
    """A warning that has to stand with the numbers, such as that they come from a smoke configuration."""
    notes: tuple[str, ...] = ()

    @property
    def heading(self) -> str:
        """Number, title and part in one line."""
        number = f"Table {self.number}, " if self.number else ""
        part = f": {self.part}" if self.part else ""
        stamp = f" [{self.stamp}]" if self.stamp else ""
        return f"{number}{self.title}{part}{stamp}"

    @property
    def cells(self) -> list[Cell]:
        """All cells, with the table's warning in their notes."""
        cells = [cell for block in self.blocks for row in block.rows for cell in row.cells]
        if not self.stamp:
            return cells
        return [msgspec.structs.replace(cell, note=note_of(self.stamp, cell.note)) for cell in cells]

    def filled(self, blocks: Iterable[Block], notes: Iterable[str] = (), **more: Any) -> Table:
        """Return the table with its blocks, empty ones left out, and with further notes behind its own.

        Args:
            blocks: Rows in printed order.
            notes: Behind the declared ones.
            more: Other fields.
        """
        full = tuple(block for block in blocks if block.rows)
        return msgspec.structs.replace(self, blocks=full, notes=(*self.notes, *notes), **more)


def note_of(*parts: str) -> str:
    """Join the parts of a note that are not empty."""
    return "; ".join(part for part in parts if part)


def metric_column(info: MetricInfo, *, in_study: bool = False, with_unit: bool = True, **more: Any) -> Column:
    """Return the column of a metric.

    Args:
        info: The metric.
        in_study: Use its title in the study's tables.
        with_unit: Name the printed unit.
        more: Other fields of the column.
    """
    title = (info.title_in_study or info.title) if in_study else info.title
    better: Literal["", "higher", "lower"] = ""
    if info.higher_is_better is not None:
        better = "higher" if info.higher_is_better else "lower"
    unit = printed_unit(info.unit).strip() if with_unit else ""
    return Column(key=info.id, title=title, better=better, unit=unit, **more)


def metric_cell(
    info: MetricInfo,
    mean: float | None,
    low: float | None = None,
    high: float | None = None,
    *,
    detectable: float | None = None,
    **about: Any,
) -> Cell:
    """Return the cell of a metric from values as stored, which are rates from 0 to 1, metres and the like.

    Args:
        info: The metric.
        mean: None for a dash, which has neither bounds nor a detectable difference.
        low: Lower bound of the interval.
        high: Upper bound of the interval.
        detectable: Smallest difference that would be found.
        about: Other fields of the cell.
    """
    stored = {"value": mean, "low": low, "high": high, "detectable": detectable}
    shown = {name: None if value is None or mean is None else info.scale * value for name, value in stored.items()}
    return Cell(metric=info.id, unit=exported_unit(info.unit), **shown, **about)
