"""What the commands of ``prbench study`` share: shapes of tables, files that they are written to, and printing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer
from prbench.cli.options import PATH
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench_benchmarks.prime_and_reach.study.document import StudyTable


class StudyNumber(msgspec.Struct, frozen=True, kw_only=True):
    """One number of a table.

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
    condition: str
    method: str
    variant: str
    low: float | None
    high: float | None
    sd: float | None
    sequences: int | None
    recordings: int | None
    detectable: float | None
    origin: str
    note: str


class MadeTable(msgspec.Struct, frozen=True, kw_only=True):
    """A table of the study, or one part of it.

    Attributes:
        number: Number in the study, such as ``S3``.
        title: What it shows.
        part: Dataset of a part; empty for a table of one part.
        stamp: A warning that belongs to all its numbers, such as that a smoke configuration made them; empty if there
            is none.
        notes: What a reader of the table needs to know.
        values: Its numbers, one a cell.
    """

    number: str
    title: str
    part: str
    stamp: str
    notes: list[str]
    values: list[StudyNumber]


class StudyReport(msgspec.Struct, frozen=True, kw_only=True):
    """What was made.

    Attributes:
        tables: The tables, or the numbers behind a figure.
        files: The files that were written.
    """

    tables: list[MadeTable]
    files: list[Path]


def runs_arguments(function: Callable) -> Callable:
    """Add ``RUN...``."""
    return click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")(function)


def require_formats(files: Sequence[Path]) -> None:
    """Refuse files of unknown formats before anything is done.

    Raises:
        UsageError: naming the first one.
    """
    from prbench_benchmarks.prime_and_reach.study.formats import require_format

    for path in files:
        require_format(path)


def study_answer(tables: Sequence[StudyTable], files: Sequence[Path], *, drawn: Path | None = None) -> Answer:
    """Write the tables and answer with their numbers."""
    from dataclasses import asdict

    from prbench_benchmarks.prime_and_reach.study.formats import write_tables

    for path in files:
        write_tables(tables, path)
    made = [
        MadeTable(
            number=table.number,
            title=table.title,
            part=table.part,
            stamp=table.stamp,
            notes=list(table.notes),
            values=[StudyNumber(**asdict(value)) for value in table.values],
        )
        for table in tables
    ]
    written = [*([] if drawn is None else [drawn]), *files]

    def show() -> None:
        """Print the tables and where they were written."""
        print_study_tables(tables)
        for path in written:
            print(f"written: {path}")

    return Answer(StudyReport(tables=made, files=written), show)


def print_study_tables(tables: Sequence[StudyTable]) -> None:
    """Print tables block by block, with their notes."""
    for table in tables:
        print(table.heading)
        for block in table.blocks:
            print_table(block.title, table.header, block.rows, numbers=range(table.text_columns, len(table.header)))
        for line in table.notes:
            print(f"- {line}")
