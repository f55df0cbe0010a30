"""Whether the file system can be withheld here, which takes bubblewrap, and the command line that does it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from prbench.methods.isolation.mounts import SYSTEM_FOLDERS, Mask, Mount, Shown, arrange

PROCESS, BUBBLEWRAP = "process", "bubblewrap"
HOME, WORK = "/tmp/home", "/tmp/work"  # inside the fence, where /tmp is empty and its own
_NAMESPACES = ("--unshare-all", "--die-with-parent", "--new-session", "--cap-drop", "ALL")
_DEVICES = ("nvidia*", "dri", "kfd", "dxg")
_PROBE_TIMEOUT = 10.0  # seconds; it takes 10 ms


@dataclass(frozen=True)
class Fence:
    """What an isolated method can be kept from on this machine."""

    kind: str
    """``bubblewrap``, or ``process`` where the file system cannot be withheld."""
    program: str | None
    """Path of bubblewrap."""
    reason: str
    """Why the file system cannot be withheld; empty if it can."""

    @property
    def notice(self) -> str:
        """For the user, before a run."""
        if self.kind == BUBBLEWRAP:
            return "isolated by bubblewrap: paths, objects, environment, network and the file system are withheld."
        return (
            "isolated in a process of its own: paths, objects and environment are withheld."
            f" THE FILE SYSTEM IS NOT WITHHELD ({self.reason}): a method that looks for the table can read it."
        )


@lru_cache(maxsize=1)
def available_fence() -> Fence:
    """The best fence that works here; tried once a process."""
    program = shutil.which("bwrap")
    if program is None:
        return Fence(PROCESS, None, "bubblewrap is not installed")
    trial = [program, *_NAMESPACES, "--ro-bind", "/", "/", "--proc", "/proc", "--dev", "/dev", "true"]
    try:
        done = subprocess.run(trial, stdin=subprocess.DEVNULL, capture_output=True, timeout=_PROBE_TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return Fence(PROCESS, None, f"bubblewrap does not work here: {error}")
    if done.returncode != 0:
        told = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        return Fence(PROCESS, None, f"bubblewrap does not work here: {told[0]}")
    return Fence(BUBBLEWRAP, program, "")


def bubblewrap_words(
    program: str, *, shown: Sequence[Shown], hidden: Sequence[Path], directory: Path | None
) -> tuple[str, ...]:
    """The words to put before a command so that it sees the system, what it is shown, and nothing else.

    Args:
        program: Path of bubblewrap.
        shown: Files and folders beside the system's.
        hidden: Folders that stay invisible even inside what is shown.
        directory: Where the command starts; None for an empty folder.
    """
    words = [program, *_NAMESPACES]
    for folder in SYSTEM_FOLDERS:
        if folder.is_symlink():
            words += ["--symlink", str(folder.readlink()), str(folder)]
        elif folder.is_dir():
            words += ["--ro-bind", str(folder), str(folder)]
    words += ["--proc", "/proc", "--dev", "/dev", "--ro-bind", "/sys", "/sys", "--tmpfs", "/tmp"]
    for device in sorted(path for pattern in _DEVICES for path in Path("/dev").glob(pattern)):
        words += ["--dev-bind-try", str(device), str(device)]
    words += ["--dir", HOME, "--dir", WORK]
    for step in arrange(shown, hidden):
        words += _step_words(step)
    return (*words, "--chdir", str(directory or WORK), "--")


def _step_words(step: Mount | Mask) -> list[str]:
    if isinstance(step, Mask):
        return ["--ro-bind", "/dev/null", str(step.place)] if step.file else ["--tmpfs", str(step.place)]
    return ["--bind" if step.writable else "--ro-bind", str(step.source), str(step.place)]
