"""Progress of long work: a bar in a terminal or below a notebook's cell, and nothing anywhere else."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator

from prbench.progress_bar import ProgressCallback, progress_bar
from prbench.shown import html

_SECONDS_BETWEEN_UPDATES = 0.2
"""A notebook redraws its page for every update, which would take longer than the work itself."""


@contextlib.contextmanager
def progress(description: str) -> Iterator[ProgressCallback]:
    """Show the progress of one piece of work while the block runs; the bar is gone afterwards.

    Args:
        description: What is being done, in a few words.
    """
    if _in_notebook():
        with _cell_bar(description) as callback:
            yield callback
    elif sys.stderr is not None and sys.stderr.isatty():
        from rich.console import Console

        with progress_bar(description, Console(stderr=True)) as callback:
            yield callback
    else:
        yield _silent


def _silent(done: int, total: int, last: str) -> None:
    """Say nothing: a script's output and a log belong to whoever wrote the script."""


def _in_notebook() -> bool:
    """Return True in a Jupyter kernel; IPython is there already then, and is never imported for this question."""
    ipython = sys.modules.get("IPython")
    if ipython is None:
        return False
    shell = ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None


@contextlib.contextmanager
def _cell_bar(description: str) -> Iterator[ProgressCallback]:
    from IPython.display import HTML, display  # type: ignore[import-not-found] - there in a notebook alone

    handle = display(HTML(_bar(description, 0, 0, "")), display_id=True)
    assert handle is not None, "a display with an id can be updated"
    shown_at = time.monotonic()

    def callback(done: int, total: int, last: str) -> None:
        nonlocal shown_at
        now = time.monotonic()
        if now - shown_at >= _SECONDS_BETWEEN_UPDATES:
            shown_at = now
            handle.update(HTML(_bar(description, done, total, last)))

    try:
        yield callback
    finally:
        handle.update(HTML(""))


def _bar(description: str, done: int, total: int, last: str) -> str:
    bar = f'<progress value="{done}" max="{total}"></progress>' if total else "<progress></progress>"
    count = f" {done}/{total}" if total else ""
    return f"<div>{html(description)} {bar}{count} {html(last)}</div>"
