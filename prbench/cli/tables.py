"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from prbench.shown import clean


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

    from prbench.cli.terminal import console

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
