"""Progress of long work: a bar on a terminal, plain lines in a log. Everything goes to standard error."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

from prbench.cli.commands import session
from prbench.progress_bar import ProgressCallback, progress_bar
from prbench.shown import clean

if TYPE_CHECKING:
    from prbench.training.loop import Progress

_SECONDS_BETWEEN_LINES = 5.0


@contextlib.contextmanager
def progress(description: str) -> Iterator[ProgressCallback]:
    """Show the progress of one piece of work while the block runs: each item as a line with ``--verbose``."""
    now = session()
    if now.quiet:
        yield lambda *_: None
    elif now.verbose:
        yield _lines(description, seconds_between=0.0)
    elif sys.stderr.isatty():
        from prbench.cli.terminal import console

        with progress_bar(description, console(stderr=True)) as callback:
            yield callback
    else:
        yield _lines(description, seconds_between=_SECONDS_BETWEEN_LINES)


def _lines(description: str, *, seconds_between: float) -> ProgressCallback:
    last_line = 0.0

    def callback(done: int, total: int, last: str) -> None:
        nonlocal last_line
        now = time.monotonic()
        if done == total or now - last_line >= seconds_between:
            last_line = now
            print(f"{description}: {done}/{total} {clean(last)}".rstrip(), file=sys.stderr, flush=True)

    return callback


@contextlib.contextmanager
def show_training(description: str) -> Iterator[Callable[[Progress], None]]:
    """Show a training on standard error while the block runs."""
    now = session()
    if now.quiet:
        yield lambda _: None
    elif sys.stderr.isatty() and not now.verbose:
        with _training_bar(description) as callback:
            yield callback
    else:
        yield _training_lines


def _training_lines(progress: Progress) -> None:
    if progress.row is not None:
        print(f"step {progress.step}/{progress.steps}: {_in_words(progress.row)}", file=sys.stderr, flush=True)
    if progress.validation is not None:
        print(f"validation at {progress.step}: {_in_words(progress.validation)}", file=sys.stderr, flush=True)


def _in_words(row: Mapping[str, float | int]) -> str:
    """Write ``loss 0.123, joints 0.01, …``, without the step."""
    return ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in row.items() if name != "step")


@contextlib.contextmanager
def _training_bar(description: str) -> Iterator[Callable[[Progress], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    from prbench.cli.terminal import console

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}", style="dim", markup=False),
    )
    with Bar(*columns, console=console(stderr=True)) as bar:
        task = bar.add_task(clean(description), total=None, last="")

        def update(progress: Progress) -> None:
            bar.update(task, completed=progress.step, total=progress.steps)
            if progress.row is not None:
                shown = f"loss {progress.row['loss']:.4g}, waiting {progress.row['waiting']:.1%}"
                bar.update(task, last=shown)
            if progress.validation is not None:
                bar.console.print(f"validation at {progress.step}: {_in_words(progress.validation)}")

        yield update
