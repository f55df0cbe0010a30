"""One process at a time writes a result: a lock beside it, held by the operating system and named after its owner.

The lock is a file ``.NAME.lock`` beside the result ``NAME``. The operating system lets go of it however its owner ends,
so a killed process never blocks; the file itself is removed when the work ends. Where the parent folder cannot be
written, it stands in the cache folder and keeps this user's processes on this machine apart. A file system without
locks is worked on without one.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from prbench.errors import ErrorOfParts, StorageError
from prbench.files.storage import atomic_path, cache_folder, remove_leftovers, text_digest
from prbench.shown import clean

_OWNER = re.compile(rb"(\d+) ([^\s]{1,255})\n")
_OWNER_AT = 1
"""Position of the owner's name in the file: Windows lets nobody read the first byte, which is the locked one."""
_PATIENCE_S = 0.2
"""Seconds that an owner may take from getting the lock to writing its name, and between two looks while waiting."""


@contextlib.contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Hold a result, file or folder, that this process is going to write; what a killed one left there is cleared away.

    Processes hold a result once: whoever calls something that holds it too must not hold it.

    Raises:
        StorageError: if another process holds it; names that process and its machine.
    """
    with _parents_only_while_needed(path), contextlib.ExitStack() as held:
        lock = _acquired(path)
        if lock is not None:
            held.callback(_release, lock)
        remove_leftovers(path)
        yield


@contextlib.contextmanager
def sole_file(path: Path) -> Iterator[Path]:
    """:func:`sole_writer` of a file that is written whole or not at all, as ``storage.atomic_path`` does.

    Raises:
        StorageError: if another process is writing it, the folder cannot be written or the disk is full.
    """
    with sole_writer(path), atomic_path(path) as temporary:
        yield temporary


@contextlib.contextmanager
def in_turn(path: Path, tell: Callable[[str], None] = lambda _: None) -> Iterator[None]:
    """:func:`sole_writer` that waits until no other process holds the result.

    Args:
        path: File or folder.
        tell: Called once for every process that is waited for, with a line that names it and its machine.
    """
    waited_for = ""
    with contextlib.ExitStack() as held:
        while True:
            try:
                held.enter_context(sole_writer(path))
                break
            except _HeldByAnotherError as refused:
                if refused.owner != waited_for:
                    waited_for = refused.owner
                    tell(f"{clean(path)}: waiting until {waited_for} has written it.")
            time.sleep(_PATIENCE_S)
        yield


def lock_file(path: Path) -> Path:
    """The file beside a result that is there while a process writes it, or after one was killed."""
    return path.with_name(f".{path.name}.lock")


class _HeldByAnotherError(ErrorOfParts, StorageError):
    """Another process writes there."""

    def __init__(self, path: Path, owner: str) -> None:
        self.path, self.owner = path, owner
        super().__init__(
            f"{clean(path)}: {owner} is writing there. Wait until it is through, or choose another folder or file."
        )


def _acquired(path: Path) -> FileLock | None:
    """The lock of a result; None where no lock can be made, as in a folder that can only be read.

    Raises:
        _HeldByAnotherError: if another process has it.
    """
    path = Path(os.path.abspath(path))  # noqa: PTH100 - a result may replace a link, whose own name counts
    for file in (
        lock_file(path),
        cache_folder() / "locks" / f"{text_digest(str(path))[:32]}.lock",
    ):
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            # A lock that is no more than a file would outlive a killed owner, so none is better.
            lock = FileLock(file, mode=0o666, fallback_to_soft=False)
            lock.acquire(blocking=False)
        except Timeout as error:
            raise _HeldByAnotherError(path, _owner(file)) from error
        except (OSError, NotImplementedError):
            continue
        _sign(file)
        return lock
    return None


def _sign(file: Path) -> None:
    """Write down who holds a lock; a full disk costs the others this name, not us the work."""
    with contextlib.suppress(OSError), open(file, "r+b", buffering=0) as opened:
        opened.seek(_OWNER_AT)
        opened.write(f"{os.getpid()} {socket.gethostname()}\n".encode())


def _owner(file: Path) -> str:
    """Process and machine that hold a lock, for a message."""
    until = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until:
        with contextlib.suppress(OSError), open(file, "rb", buffering=0) as opened:
            opened.seek(_OWNER_AT)
            match = _OWNER.match(opened.read(300))
            if match:
                return f"process {int(match[1])} on {clean(match[2].decode(errors='replace'))}"
        time.sleep(_PATIENCE_S / 10)
    return "another process"


def _release(lock: FileLock) -> None:
    """Remove the file while it is still held, so that nobody can be holding it; then let go.

    Whoever opened it before finds out that it has no name any more, and tries again with a new one. Windows removes no
    file that is open; there it goes afterwards, unless somebody has opened it again.
    """
    with contextlib.suppress(OSError):
        Path(lock.lock_file).unlink()
    lock.release()
    if os.name == "nt":
        with contextlib.suppress(OSError):
            Path(lock.lock_file).unlink()


@contextlib.contextmanager
def _parents_only_while_needed(path: Path) -> Iterator[None]:
    """Remove the folders that the lock has made in the end, if the work has put nothing there."""
    made = [parent for parent in path.absolute().parents if not parent.exists()]
    try:
        yield
    finally:
        for parent in made:
            with contextlib.suppress(OSError):  # not empty
                parent.rmdir()
