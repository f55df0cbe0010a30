"""One table of the study: blocks of printed rows, and the numbers behind them one a row."""

from __future__ import annotations

from dataclasses import dataclass

MEASURED = "measured"
SYNTHETIC = "measured on synthetic data"
DASH = "–"


@dataclass(frozen=True, kw_only=True)
class StudyValue:
    """One number of a table, as its CSV file holds it: rates in %, lengths in metres, times in seconds."""

    dataset: str
    metric: str
    value: float | None
    """None where a dash is printed."""
    unit: str
    condition: str = ""
    method: str = ""
    variant: str = ""
    low: float | None = None
    high: float | None = None
    """Bounds of the 95 % interval."""
    sd: float | None = None
    """Standard deviation over sequences, or the number after ± in the study."""
    sequences: int | None = None
    recordings: int | None = None
    detectable: float | None = None
    """Smallest difference to an unrelated method of the same spread that would be found with 80 % power."""
    origin: str = MEASURED
    """``measured``, ``measured on synthetic data``, ``published: …``, or ``measured - published``."""
    note: str = ""


@dataclass(frozen=True)
class StudyBlock:
    """Rows of one origin: measured and published ones never stand in the same block."""

    title: str
    """Says where the numbers come from; empty in a table of one block."""
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, kw_only=True)
class StudyTable:
    """A table, or what a figure draws."""

    number: str
    """Number in the study, such as ``2`` or ``S3``."""
    title: str
    header: tuple[str, ...]
    blocks: tuple[StudyBlock, ...]
    values: tuple[StudyValue, ...]
    text_columns: int = 1
    """Columns at the left that hold words; the others are set to the right."""
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
