"""Progress of long work: a bar on a terminal, plain lines in a log. Everything goes to standard error."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator

from prbench.cli.commands import session
from prbench.progress_bar import ProgressCallback, progress_bar
from prbench.shown import clean

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
