"""Input that several tests read and none writes to: made once a run, whichever test process needs it first."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from filelock import FileLock

FOLDER = "PRBENCH_TESTS_SHARED"


def open_folder() -> None:
    """Make the folder that all processes of this run share; it is removed when the process that made it ends."""
    if FOLDER not in os.environ:
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="prbench-tests-")
        atexit.register(_remove, os.environ[FOLDER], os.getpid())


def _remove(folder: str, process: int) -> None:
    if os.getpid() == process:  # forked children end too
        shutil.rmtree(folder, ignore_errors=True)


def made_once(name: str, make: Callable[[Path], object]) -> Path:
    """Return the path below which ``make`` has written, calling it only if no process of this run has done so.

    Args:
        name: Name of what is made; two tests that give the same name share it.
        make: Writes a file or a folder at the path that it is given.
    """
    made = Path(os.environ[FOLDER]) / name
    with FileLock(f"{made}.lock"):
        if not made.exists():
            unfinished = made.with_name(f"{name}.unfinished")
            make(unfinished)
            unfinished.rename(made)
    return made
