"""One process at a time works on the folder of a table."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from prbench.errors import RunError, StorageError

if sys.platform != "win32":
    import fcntl


@contextlib.contextmanager
def working_alone(folder: Path) -> Iterator[None]:
    """Hold a folder, which is made if it is not there; the operating system lets go of it however the process ends.

    Raises:
        RunError: if another process holds it.
        StorageError: if it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"{folder}: cannot be written ({error.strerror}). Choose another folder for --out."
        ) from error
    if sys.platform == "win32":  # where folders cannot be locked
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        _lock(handle, folder)
        yield
    finally:
        os.close(handle)


def _lock(handle: int, folder: Path) -> None:
    if sys.platform == "win32":
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise RunError(
            f"{folder}: another process is working on this table. Wait until it is through, or choose another folder"
            " for --out."
        ) from error
    except OSError:  # a file system without locks
        return
