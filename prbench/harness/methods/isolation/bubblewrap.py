"""Arrange the folders that appear behind the fence, and make the command line of bubblewrap that shows them."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

_PROCESS = "process"
BUBBLEWRAP = "bubblewrap"
HOME = "/tmp/home"  # inside the fence, where /tmp is empty and its own
_WORK = "/tmp/work"
_NAMESPACES = ("--unshare-all", "--die-with-parent", "--new-session", "--cap-drop", "ALL")
_DEVICES = ("nvidia*", "dri", "kfd", "dxg")
_PROBE_TIMEOUT = 10.0  # seconds; it takes 10 ms
_SYSTEM_FOLDERS = tuple(
    Path(name) for name in ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/etc", "/nix/store")
)


@dataclass(frozen=True)
class Shown:
    """A file or folder that a method needs."""

    path: Path
    writable: bool = False
    essential: bool = False
    """Shown even inside a hidden folder, such as the weights that the user named."""


@dataclass(frozen=True)
class Mount:
    """``source`` appears at ``place``."""

    source: Path
    place: Path
    writable: bool = False


@dataclass(frozen=True)
class Mask:
    """Nothing is to be seen at ``place``."""

    place: Path
    file: bool = False


def arrange(shown: Sequence[Shown], hidden: Sequence[Path]) -> list[Mount | Mask]:
    """Return mounts and masks in the order in which they have to be made: outer ones before inner ones.

    Links are followed once, here: what a shown path leads to appears under its own name too, and a hidden folder is
    covered wherever it would appear. Hidden folders that do not exist yet are made where they have to be covered.
    """
    secrets = [path.resolve() for path in dict.fromkeys(hidden)]
    mounts = _without_nested(list(_mounts(shown, secrets)), secrets)
    masks = list(dict.fromkeys(_masks([*mounts, *_of_system()], secrets)))
    # A mask comes after the mount of the same depth, or the mount would uncover it.
    return sorted([*mounts, *masks], key=lambda step: (len(step.place.parts), isinstance(step, Mask)))


@dataclass(frozen=True)
class Fence:
    """The kind of isolation that works on this machine."""

    kind: str
    """``bubblewrap``, or ``process`` where the file system cannot be withheld."""
    program: str | None
    """Path of bubblewrap."""
    reason: str
    """Reason why the file system cannot be withheld; empty if it can."""

    @property
    def notice(self) -> str:
        """Message that the user gets before a run."""
        if self.kind == BUBBLEWRAP:
            return "isolated by bubblewrap: paths, objects, environment, network and the file system are withheld."
        return (
            "isolated in a process of its own: paths, objects and environment are withheld."
            f" THE FILE SYSTEM IS NOT WITHHELD ({self.reason}): a method that looks for the table can read it."
        )


@lru_cache(maxsize=1)
def available_fence() -> Fence:
    """Return the best fence that works here; tried once a process."""
    program = shutil.which("bwrap")
    if program is None:
        return Fence(_PROCESS, None, "bubblewrap is not installed")
    trial = [program, *_NAMESPACES, "--ro-bind", "/", "/", "--proc", "/proc", "--dev", "/dev", "true"]
    try:
        done = subprocess.run(trial, stdin=subprocess.DEVNULL, capture_output=True, timeout=_PROBE_TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return Fence(_PROCESS, None, f"bubblewrap does not work here: {error}")
    if done.returncode != 0:
        told = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        return Fence(_PROCESS, None, f"bubblewrap does not work here: {told[0]}")
    return Fence(BUBBLEWRAP, program, "")


def bubblewrap_words(
    program: str, *, shown: Sequence[Shown], hidden: Sequence[Path], directory: Path | None
) -> tuple[str, ...]:
    """Return the words before a command that let it see the system, what it is shown, and nothing else.

    Args:
        program: Path of bubblewrap.
        shown: Files and folders beside the system's.
        hidden: Folders that stay invisible even inside what is shown.
        directory: Where the command starts; None for an empty folder.
    """
    words = [program, *_NAMESPACES]
    for folder in _SYSTEM_FOLDERS:
        if folder.is_symlink():
            words += ["--symlink", str(folder.readlink()), str(folder)]
        elif folder.is_dir():
            words += ["--ro-bind", str(folder), str(folder)]
    words += ["--proc", "/proc", "--dev", "/dev", "--ro-bind", "/sys", "/sys", "--tmpfs", "/tmp"]
    # /dev is empty inside, and a GPU is reached through these files.
    for device in sorted(path for pattern in _DEVICES for path in Path("/dev").glob(pattern)):
        words += ["--dev-bind-try", str(device), str(device)]
    words += ["--dir", HOME, "--dir", _WORK]
    for step in arrange(shown, hidden):
        words += _step_words(step)
    return (*words, "--chdir", str(directory or _WORK), "--")


def _mounts(shown: Sequence[Shown], secrets: Sequence[Path]) -> Iterator[Mount]:
    for item in shown:
        source = item.path.resolve()
        if not source.exists() or (not item.essential and _inside_any(source, secrets)):
            continue
        yield Mount(source, source, item.writable)
        if item.path != source:
            yield Mount(source, item.path, item.writable)


def _without_nested(mounts: list[Mount], secrets: Sequence[Path]) -> list[Mount]:
    """Leave out what an outer mount shows already; not what lies in a place that is going to be covered."""
    kept = _of_system()
    for mount in sorted(dict.fromkeys(mounts), key=lambda one: (len(one.place.parts), not one.writable)):
        repeated = any(mount.place.is_relative_to(outer.place) for outer in kept)
        if not repeated or mount.writable or _inside_any(mount.source, secrets):
            kept.append(mount)
    return [mount for mount in kept if mount.place not in _SYSTEM_FOLDERS]


def _masks(mounts: Sequence[Mount], secrets: Sequence[Path]) -> Iterator[Mask]:
    for mount in mounts:
        for secret in secrets:
            if mount.source.is_dir() and secret.is_relative_to(mount.source) and _made(secret):
                yield Mask(mount.place / secret.relative_to(mount.source), secret.is_file())


def _made(folder: Path) -> bool:
    """Make a folder that is to be covered; one that cannot be made now will not appear later either."""
    try:
        if not folder.exists():
            folder.mkdir(parents=True)
    except OSError:
        return False
    return True


def _of_system() -> list[Mount]:
    return [Mount(folder.resolve(), folder) for folder in _SYSTEM_FOLDERS if folder.is_dir()]


def _inside_any(path: Path, folders: Sequence[Path]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _step_words(step: Mount | Mask) -> list[str]:
    if isinstance(step, Mask):
        return ["--ro-bind", "/dev/null", str(step.place)] if step.file else ["--tmpfs", str(step.place)]
    return ["--bind" if step.writable else "--ro-bind", str(step.source), str(step.place)]
