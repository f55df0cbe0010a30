"""One table of the study: blocks of printed rows, and the numbers behind them one a row."""

from __future__ import annotations

from dataclasses import dataclass

MEASURED = "measured"
SYNTHETIC = "measured on synthetic data"
DASH = "–"


@dataclass(frozen=True, kw_only=True)
class StudyValue:
    """One number of a table, as its CSV file holds it.

    Attributes:
        dataset: Name of the dataset.
        metric: Id of the metric or quantity.
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
        origin: ``measured``, ``measured on synthetic data``, ``published: …`` or ``measured - published: …``.
        note: What a reader of the number needs to know.
    """

    dataset: str
    metric: str
    value: float | None
    unit: str
    condition: str = ""
    method: str = ""
    variant: str = ""
    low: float | None = None
    high: float | None = None
    sd: float | None = None
    sequences: int | None = None
    recordings: int | None = None
    detectable: float | None = None
    origin: str = MEASURED
    note: str = ""


@dataclass(frozen=True)
class StudyBlock:
    """Rows of one origin: measured and published ones never stand in the same block."""

    title: str
    """Says where the numbers come from; empty in a table of one block."""
    rows: tuple[tuple[str, ...], ...]
    """Cells as printed."""


@dataclass(frozen=True, kw_only=True)
class StudyTable:
    """A table, or what a figure draws."""

    number: str
    """Number in the study, such as ``2`` or ``S3``."""
    title: str
    """What it shows."""
    header: tuple[str, ...]
    """Names of the printed columns."""
    blocks: tuple[StudyBlock, ...]
    """Rows as printed, by where they come from."""
    values: tuple[StudyValue, ...]
    """Its numbers, one a cell."""
    text_columns: int = 1
    """Columns at the left that hold words; the others are set to the right."""
    dataset: str = ""
    """Dataset of one part of a table that has several."""
    part: str = ""
    """The part in words: dataset, and how much data stand behind it."""
    stamp: str = ""
    """A warning that has to stand with the numbers, such as that they come from a smoke configuration."""
    notes: tuple[str, ...] = ()
    """What a reader of the table needs to know."""

    @property
    def heading(self) -> str:
        """Number, title and part in one line."""
        part = f": {self.part}" if self.part else ""
        stamp = f" [{self.stamp}]" if self.stamp else ""
        return f"Table {self.number}, {self.title}{part}{stamp}"


def interval_text(mean: float | None, low: float | None, high: float | None, *, sign: bool = False) -> str:
    """Write a mean with its interval, in the printed unit; a dash for None."""
    if mean is None:
        return DASH
    form = "+.2f" if sign else ".2f"
    bounds = "" if low is None or high is None else f" [{low:{form}}, {high:{form}}]"
    return f"{mean:{form}}{bounds}"
