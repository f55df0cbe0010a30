"""The log of a program: its stderr in a file of bounded size, the last lines at hand for messages."""

from __future__ import annotations

import contextlib
import os
import re
import threading
from pathlib import Path
from typing import IO

from prbench.files.storage import cache_folder

_PART = 512 * 1024
"""Bytes kept of the beginning of a log, and at least as many of its end, at most twice as many."""
_TAIL_BYTES = 8192
_KEPT_LOGS = 100


class ProgramLog:
    """Takes in stderr all the time, so that a program that writes much is never held up.

    The file is made when the first byte comes. Once it is full, its first half megabyte stays and its latest half
    megabytes take turns.
    """

    def __init__(self, stderr: IO[bytes], name: str, pid: int) -> None:
        self._path = cache_folder() / "logs" / f"{_file_name(name)}-{pid}.log"
        self._tail = b""
        self._written = False
        self._ended = threading.Event()
        threading.Thread(target=self._drain, args=(stderr,), name=f"log of {name}", daemon=True).start()

    @property
    def path(self) -> Path | None:
        """The file; None while nothing was written, or if it could not be."""
        return self._path if self._written else None

    def tail(self, lines: int = 10) -> list[str]:
        """Return the last lines, overlong ones cut."""
        text = self._tail.decode(errors="replace")
        return [_printable(line) for line in text.splitlines() if line.strip()][-lines:]

    def wait_for_end(self, seconds: float) -> None:
        """Wait until everything is read; not for ever, since a forgotten child may hold stderr open."""
        self._ended.wait(seconds)

    def _drain(self, stderr: IO[bytes]) -> None:
        with contextlib.ExitStack() as open_files:
            open_files.callback(self._ended.set)
            open_files.callback(stderr.close)
            file: _BoundedFile | None = None
            while chunk := os.read(stderr.fileno(), 65_536):
                self._tail = (self._tail + chunk)[-_TAIL_BYTES:]
                if file is None:
                    file = open_files.enter_context(_BoundedFile(self._path))
                self._written = file.write(chunk)


class _BoundedFile:
    """A file that keeps its beginning and its latest part; gives up quietly if the disk does not take it."""

    def __init__(self, path: Path) -> None:
        self._file: IO[bytes] | None = None
        self._size = self._cut = 0
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            _prune(path.parent)
            self._file = path.open("wb", buffering=0)

    def __enter__(self) -> _BoundedFile:
        return self

    def __exit__(self, *error: object) -> None:
        if self._file is not None:
            self._file.close()

    def write(self, chunk: bytes) -> bool:
        """Append; false if there is no file to append to."""
        if self._file is None:
            return False
        try:
            if self._size + len(chunk) > 2 * _PART:
                self._begin_latest_part(self._file)
            self._size += self._file.write(chunk) or 0
        except OSError:  # a full disk must not stop the program; the last lines are still in memory
            self._file.close()
            self._file = None
            return False
        return True

    def _begin_latest_part(self, file: IO[bytes]) -> None:
        # The beginning tells how the program was set up, the end why it failed; the middle goes.
        kept = min(_PART, self._size)
        self._cut += self._size - kept
        file.seek(kept)
        file.truncate()
        note = f"\n[… {self._cut:,} bytes cut here by prbench …]\n".encode()
        file.write(note)
        self._size = kept


def _file_name(name: str) -> str:
    """Make a file name of the name that a program has in messages: folders and odd characters are left out.

    >>> _file_name("/opt/envs/glide/bin/python '/home/me/my glide.py' --fast")
    'python-my-glide.py---fast'
    """
    without_folders = re.sub(r"[^\s'\"]*[/\\]", "", name)
    return re.sub(r"[^A-Za-z0-9._-]+", "-", without_folders).strip("-.")[:60] or "program"


def _prune(folder: Path) -> None:
    """Delete all but the newest logs."""
    logs = sorted(folder.glob("*.log"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in logs[_KEPT_LOGS:]:
        path.unlink(missing_ok=True)


def _printable(line: str) -> str:
    """Remove what would move the cursor or colour a terminal."""
    line = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line.expandtabs(4))
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in line)[:400]
