"""Which folders appear behind the fence, where, and which places in them are covered."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

SYSTEM_FOLDERS = tuple(
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
    """Mounts and masks in the order in which they have to be made: outer ones before inner ones.

    Links are followed once, here: what a shown path leads to appears under its own name too, and a hidden folder is
    covered wherever it would appear. Hidden folders that do not exist yet are made where they have to be covered.
    """
    secrets = [path.resolve() for path in dict.fromkeys(hidden)]
    mounts = _without_nested(list(_mounts(shown, secrets)), secrets)
    masks = list(dict.fromkeys(_masks([*mounts, *_of_system()], secrets)))
    return sorted([*mounts, *masks], key=lambda step: (len(step.place.parts), isinstance(step, Mask)))


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
    return [mount for mount in kept if mount.place not in SYSTEM_FOLDERS]


def _masks(mounts: Sequence[Mount], secrets: Sequence[Path]) -> Iterator[Mask]:
    for mount in mounts:
        for secret in secrets:
            if mount.source.is_dir() and secret.is_relative_to(mount.source) and _made(secret):
                yield Mask(mount.place / secret.relative_to(mount.source), secret.is_file())


def _made(folder: Path) -> bool:
    """Whether a folder is there to be covered; one that cannot be made now will not appear later either."""
    try:
        if not folder.exists():
            folder.mkdir(parents=True)
    except OSError:
        return False
    return True


def _of_system() -> list[Mount]:
    return [Mount(folder.resolve(), folder) for folder in SYSTEM_FOLDERS if folder.is_dir()]


def _inside_any(path: Path, folders: Sequence[Path]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)
