"""The bar that commands and the Python interface show on a terminal while something takes long."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from prbench.shown import clean

if TYPE_CHECKING:
    from rich.console import Console

# Called with finished steps, all steps, and what was finished last.
ProgressCallback = Callable[[int, int, str], None]


@contextlib.contextmanager
def progress_bar(description: str, console: Console) -> Iterator[ProgressCallback]:
    """Show a bar with what is finished and the time that is left while the block runs; it is gone afterwards.

    Args:
        description: What is being done, in a few words.
        console: Console that it is drawn on.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}", style="dim", markup=False),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(clean(description), total=None, last="")
        yield lambda done, total, last: bar.update(task, completed=done, total=total, last=clean(last))
