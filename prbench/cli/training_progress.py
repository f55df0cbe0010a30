"""Progress of a training: a bar with the loss on a terminal, a line for every entry of the log elsewhere."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

from prbench.shown import clean

if TYPE_CHECKING:
    from prbench.training.loop import Progress


@contextlib.contextmanager
def show_training(description: str) -> Iterator[Callable[[Progress], None]]:
    """Show a training on standard error while the block runs."""
    if sys.stderr.isatty():
        with _bar(description) as callback:
            yield callback
    else:
        yield _print_lines


def _print_lines(progress: Progress) -> None:
    if progress.row is not None:
        print(f"step {progress.step}/{progress.steps}: {in_words(progress.row)}", file=sys.stderr, flush=True)
    if progress.validation is not None:
        print(f"validation at {progress.step}: {in_words(progress.validation)}", file=sys.stderr, flush=True)


def in_words(row: Mapping[str, float | int]) -> str:
    """``loss 0.123, joints 0.01, …``; the step apart."""
    return ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in row.items() if name != "step")


@contextlib.contextmanager
def _bar(description: str) -> Iterator[Callable[[Progress], None]]:
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
                bar.console.print(f"validation at {progress.step}: {in_words(progress.validation)}")

        yield update
