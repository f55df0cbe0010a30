"""Keep what a process knows from other processes of the same user, as far as Linux lets it.

They find in ``/proc`` how it was called, and its variables, working directory, open files and memory.
"""

from __future__ import annotations

import ctypes
import os
import sys
from multiprocessing import resource_tracker, util
from pathlib import Path

_PR_GET_DUMPABLE = 3
_PR_SET_DUMPABLE = 4
_NEEDED = ("PATH", "LD_LIBRARY_PATH")
_NAME = b"prbench"


def hide_process() -> None:
    """Blank the command line of this process and make the rest unreadable until it ends; on Linux only."""
    if sys.platform != "linux":
        return
    # Fields 48 and 49 of proc_pid_stat(5), counted from the third: where the words lie that `ps` shows.
    fields = Path("/proc/self/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    start = int(fields[45])
    length = int(fields[46]) - start
    if start and length > len(_NAME):
        ctypes.memset(start, 0, length)
        ctypes.memmove(start, _NAME, len(_NAME))
    ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0)


def is_hidden() -> bool:
    """Return True after :func:`hide_process`."""
    return sys.platform == "linux" and ctypes.CDLL(None).prctl(_PR_GET_DUMPABLE, 0, 0, 0, 0) == 0


def start_bare_tracker() -> None:
    """Start the helper process of ``multiprocessing``, which cannot be hidden, without variables and in the root."""

    def spawn(path: bytes | str, words: list[bytes | str], descriptors: tuple[int, ...]) -> int:
        kept = {name: os.environ[name] for name in _NEEDED if name in os.environ}
        command = ["sh", "-c", 'cd / && exec "$@"', "sh", path, *words[1:]]
        inherited = [(os.POSIX_SPAWN_DUP2, number, number) for number in descriptors]
        return os.posix_spawn("/bin/sh", command, kept, file_actions=inherited)

    usual = util.spawnv_passfds
    util.spawnv_passfds = spawn
    try:
        resource_tracker.ensure_running()
    finally:
        util.spawnv_passfds = usual
