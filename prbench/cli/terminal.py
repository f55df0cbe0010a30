"""Printed tables and columns; text from files in them cannot steer the terminal."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from prbench.shown import clean

if TYPE_CHECKING:
    from rich.console import Console

    from prbench.tables import Table


Rows = Iterable[Sequence[str]]


class _CleanStream:
    """A text stream that spells out escape sequences and the like; line breaks and tabs stay.

    Everything but writing is that of the stream behind it. (A subclass of ``io.TextIOBase`` would close that one when
    it is cleared away itself.)

    Args:
        behind: The stream behind it.
        renamed: Replaces some texts by others.
    """

    def __init__(self, behind: Any, renamed: Callable[[str], str] = str) -> None:
        self.raw = behind.raw if isinstance(behind, _CleanStream) else behind
        self._renamed = renamed

    def write(self, text: str) -> int:
        """Write a text, cleaned; return how many of its characters were taken, which is all of them.

        Raises:
            TypeError: for bytes, by which click finds out that this is a text stream.
        """
        if not isinstance(text, str):
            raise TypeError(f"expected text, found {type(text).__name__}")
        self.raw.write(clean(self._renamed(text), keep="\n\t"))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write some texts, cleaned."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        """Hand everything else on."""
        return getattr(self.raw, name)


@contextlib.contextmanager
def clean_output() -> Iterator[None]:
    """Clean everything that is printed to standard output and error while the block runs."""
    out: Any = _CleanStream(sys.stdout)
    err: Any = _CleanStream(sys.stderr)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        yield


@contextlib.contextmanager
def renamed_output(renamed: Callable[[str], str]) -> Iterator[None]:
    """Change all texts that the block prints to standard output, but for tables."""
    stream: Any = _CleanStream(sys.stdout, renamed)
    with contextlib.redirect_stdout(stream):
        yield


def console(*, stderr: bool = False, **settings: Any) -> Console:
    """Make a console for tables and bars, which steers the terminal itself; its callers clean the text they hand it.

    Markup is off: a name such as ``[red]`` is shown as it is.
    """
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    if os.environ.get("NO_COLOR"):  # Rich itself would leave bold and italic text
        settings["color_system"] = None
    return Console(
        file=stream.raw if isinstance(stream, _CleanStream) else stream, highlight=False, markup=False, **settings
    )


def print_table(title: str, header: Sequence[str], rows: Rows, *, numbers: Collection[int] = ()) -> None:
    """Print rows under a header; on a terminal that is too narrow for whole words, one line a cell.

    Args:
        title: Printed above.
        header: Names of the columns.
        rows: Cells, as many as there are names; a cell may have several lines.
        numbers: Columns that are set to the right.
    """
    shown = [tuple(clean(cell, keep="\n") for cell in row) for row in rows]
    output = console()
    if not output.is_terminal:  # in a file or pipe nothing is folded to the width of a terminal that is not there
        output = console(width=max(200, output.width))
    output.print(clean(title), style="italic", soft_wrap=True)  # a table folds its own title to its width
    widths = _column_widths([header, *shown], output.width, numbers)
    if widths is None:
        _print_stacked(output, header, shown)
    else:
        from rich import box
        from rich.table import Table

        table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
        for index, (name, width) in enumerate(zip(header, widths)):
            table.add_column(name, justify="right" if index in numbers else "left", overflow="fold", width=width)
        for row in shown:
            table.add_row(*row)
        output.print(table)


_BETWEEN_COLUMNS = 3  # of Rich's table: a space on either side of a cell, and one for the line that is not drawn


def _column_widths(rows: Sequence[Sequence[str]], available: int, numbers: Collection[int]) -> list[int] | None:
    """Share the width among the columns so that no word and no number is broken; return None where it does not suffice.

    Columns of numbers keep their width, since ``0.59 ±`` above ``0.17`` is hard to read.
    """
    columns = list(zip(*rows))
    longest_lines = [max((len(line) for cell in column for line in cell.splitlines()), default=0) for column in columns]
    longest_words = [max((len(word) for cell in column for word in cell.split()), default=0) for column in columns]
    needed = []
    for index, (line, word) in enumerate(zip(longest_lines, longest_words)):
        needed.append(line if index in numbers else word)
    to_share = available - _BETWEEN_COLUMNS * len(columns) - 1 - sum(needed)
    if to_share < 0:
        return None
    wanted = [line - least for line, least in zip(longest_lines, needed)]
    widths = needed
    # Columns that want little are served first, so that only those with long texts are folded.
    for served, index in enumerate(sorted(range(len(columns)), key=lambda column: wanted[column])):
        extra = min(wanted[index], to_share // (len(columns) - served))
        widths[index] += extra
        to_share -= extra
    return widths


def _print_stacked(output: Console, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print every row as a block: its first cell, and below it one line for each other cell that is not empty."""
    for row in rows:
        output.print(f"\n{row[0]}", style="bold", soft_wrap=True)
        for name, cell in zip(header[1:], row[1:]):
            if cell:
                label = f"{name}: " if name else ""
                output.print(f"  {label}{cell}".replace("\n", " "))
    output.print()


def print_columns(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows in columns as wide as their widest cells, never folded; on a narrower terminal one line a cell.

    Args:
        header: Names of the columns; empty names are left out, and so is a header without any name.
        rows: Cells, as many as there are names.
    """
    lines = [header, *rows] if any(header) else list(rows)
    widths = [max(len(cell) for cell in column) for column in zip(*lines)]
    joined = ["  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths)).rstrip() for line in lines]
    available = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    if available is not None and max(map(len, joined), default=0) > available:
        _print_stacked(console(), header, [tuple(clean(cell) for cell in row) for row in rows])
    else:
        for line in joined:
            print(line)


def print_tables(tables: Iterable[Table], *, between: str = " ") -> None:
    """Print tables of the table engine block by block, with their notes.

    Args:
        tables: The tables, in printed order.
        between: Stands between a number and its interval; a line break makes columns narrower.
    """
    from prbench.tables import grid

    for table in tables:
        print(table.heading)
        for block in table.blocks:
            rows = grid(table, block, escape=str, bold=lambda number: f"{number}¹", between=between)
            numbers = [index for index, column in enumerate(table.columns) if not column.text]
            print_table(block.title, [column.heading for column in table.columns], rows, numbers=numbers)
        for line in table.notes:
            print(f"- {line}")
