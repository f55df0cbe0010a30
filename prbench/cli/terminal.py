"""Printed tables and columns; text from files in them cannot steer the terminal."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from prbench.shown import clean

if TYPE_CHECKING:
    from rich.console import Console


class _CleanStream:
    """A text stream that spells out escape sequences and the like; line breaks and tabs stay.

    Everything but writing is that of the stream behind it. (A subclass of ``io.TextIOBase`` would close that one when
    it is cleared away itself.)

    Args:
        raw: The stream behind it.
    """

    def __init__(self, raw: Any) -> None:
        self.raw = raw

    def write(self, text: str) -> int:
        """Write a text, cleaned; return how many of its characters were taken, which is all of them."""
        self.raw.write(clean(text, keep="\n\t"))
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
    with contextlib.redirect_stdout(_cleaned(sys.stdout)), contextlib.redirect_stderr(_cleaned(sys.stderr)):
        yield


def _cleaned(stream: Any) -> Any:
    return stream if isinstance(stream, _CleanStream) else _CleanStream(stream)


def console(*, stderr: bool = False, **settings: Any) -> Console:
    """Make a console for tables and bars, which steers the terminal itself; its callers clean the text they hand it.

    Markup is off: a name such as ``[red]`` is shown as it is.
    """
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    return Console(
        file=stream.raw if isinstance(stream, _CleanStream) else stream, highlight=False, markup=False, **settings
    )


def print_table(
    title: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Collection[int] = (),
    spaced: bool = False,
) -> None:
    """Print rows under a header; columns listed in ``numbers`` are set to the right, ``spaced`` rows stand apart."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_lines=spaced)
    for index, name in enumerate(header):
        table.add_column(name, justify="right" if index in numbers else "left", overflow="fold")
    for row in rows:
        table.add_row(*(clean(cell, keep="\n") for cell in row))
    output = console()
    if not output.is_terminal:  # in a file or pipe nothing is folded to the width of a terminal that is not there
        output = console(width=max(200, output.width))
    output.print(clean(title), style="italic", soft_wrap=True)  # a table folds its own title to its width
    output.print(table)


def print_columns(rows: Sequence[tuple[str, ...]]) -> None:
    """Print rows of equally many cells, each column as wide as its widest cell."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows)]
    for row in rows:
        print("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths)).rstrip())
