"""Progress of long work: a bar on a terminal, plain lines in a log. Everything goes to standard error."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

ProgressCallback = Callable[[int, int, str], None]
"""Called with finished items, all items, and what was finished last."""

_SECONDS_BETWEEN_LINES = 5.0


@contextlib.contextmanager
def progress(description: str) -> Iterator[ProgressCallback]:
    """Show the progress of one piece of work while the block runs."""
    if sys.stderr.isatty():
        with _bar(description) as callback:
            yield callback
    else:
        yield _lines(description)


@contextlib.contextmanager
def _bar(description: str) -> Iterator[ProgressCallback]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}", style="dim"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None, last="")
        yield lambda done, total, last: bar.update(task, completed=done, total=total, last=last)


def _lines(description: str) -> ProgressCallback:
    last_line = 0.0

    def callback(done: int, total: int, last: str) -> None:
        nonlocal last_line
        now = time.monotonic()
        if done == total or now - last_line >= _SECONDS_BETWEEN_LINES:
            last_line = now
            print(f"{description}: {done}/{total} {last}".rstrip(), file=sys.stderr, flush=True)

    return callback
