"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence


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
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_lines=spaced)
    for index, name in enumerate(header):
        table.add_column(name, justify="right" if index in numbers else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:  # in a file or pipe nothing is folded to the width of a terminal that is not there
        console = Console(highlight=False, markup=False, width=max(200, console.width))
    console.print(title, style="italic", soft_wrap=True)  # a table folds its own title to its width
    console.print(table)
