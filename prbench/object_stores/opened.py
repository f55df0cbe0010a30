"""URLs that this command, or the one that has started this process, works on as local copies already."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

VARIABLE = "PRBENCH_LOCAL_COPIES"
"""Environment variable that tells the processes that a command starts: JSON, from URLs to local copies. They write
there and leave the uploading to the command."""


def opened_elsewhere(text: str) -> Path | None:
    """Return the local copy of a URL that is worked on already; None for any other."""
    copies = _copies()
    return Path(copies[text]) if text in copies else None


@contextlib.contextmanager
def opened(text: str, path: Path) -> Iterator[None]:
    """Tell the processes that the block starts about a local copy."""
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = json.dumps({**_copies(), text: str(path)})
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(VARIABLE, None)
        else:
            os.environ[VARIABLE] = before


def _copies() -> dict[str, str]:
    return json.loads(os.environ.get(VARIABLE) or "{}")
