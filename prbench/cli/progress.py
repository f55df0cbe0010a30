"""Progress of long work: a bar on a terminal, plain lines in a log. Everything goes to standard error."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from prbench.shown import clean

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
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from prbench.cli.terminal import console

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}", style="dim", markup=False),
    )
    with Progress(*columns, console=console(stderr=True), transient=True) as bar:
        task = bar.add_task(clean(description), total=None, last="")
        yield lambda done, total, last: bar.update(task, completed=done, total=total, last=clean(last))


def _lines(description: str) -> ProgressCallback:
    last_line = 0.0

    def callback(done: int, total: int, last: str) -> None:
        nonlocal last_line
        now = time.monotonic()
        if done == total or now - last_line >= _SECONDS_BETWEEN_LINES:
            last_line = now
            print(f"{description}: {done}/{total} {clean(last)}".rstrip(), file=sys.stderr, flush=True)

    return callback
