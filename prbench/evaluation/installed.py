"""What package metadata say about installed methods, read so that one damaged package never hides the others.

``importlib.metadata.entry_points`` gives up on the first line that it cannot parse, and with it every command that
names a method. Here each package is read by itself, and what is wrong with it is said beside its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import Distribution, EntryPoint, distributions

from prbench.contract import ENTRY_POINT_GROUP
from prbench.errors import AdapterError, did_you_mean

_UNKNOWN = "unknown"
_TARGET = re.compile(r"[A-Za-z_][\w.]*\s*:\s*[A-Za-z_][\w.]*\s*(\[.*\])?")
_PROGRAM_SUFFIXES = (".py", ".js", ".mjs", ".sh", ".exe", ".jl", ".rb", ".r", ".m")


@dataclass(frozen=True, order=True)
class InstalledAdapter:
    """What package metadata say about a method; nothing of it was imported."""

    name: str
    package: str
    version: str
    target: str
    """``module:callable``."""
    problem: str = ""
    """What is wrong with the metadata, so that the method cannot be used; empty if nothing is."""


def list_adapters() -> list[InstalledAdapter]:
    """All installed methods by name, without importing any of them; those with unusable metadata say why."""
    return sorted(set(_adapters()))


def offered_twice(adapters: Iterable[InstalledAdapter]) -> frozenset[str]:
    """Names that more than one package offers; such a name cannot be used until one of them is uninstalled."""
    names = [adapter.name for adapter in adapters]
    return frozenset(name for name in names if names.count(name) > 1)


def entry_points_of(group: str) -> Iterator[EntryPoint]:
    """The readable entry points of a group; unreadable ones are passed over."""
    for distribution in _distributions():
        for line in _lines(distribution, group):
            name, separator, value = (part.strip() for part in line.partition("="))
            if separator and name and value:
                yield EntryPoint(name, value, group)


def no_such_method(name: str, known: Iterable[str]) -> AdapterError:
    """The answer to a method's name that nobody knows: the nearest known one, or how a program or a file is given."""
    hint = did_you_mean(name, known) or _as_program(name)
    return AdapterError(f"adapter '{name}' is not installed.{hint} `prbench adapters list` shows all of them.")


def _as_program(name: str) -> str:
    """A hint for what looks like a program, a file of its results, or a command."""
    words = name.split()
    if name.lower().endswith(".toml"):
        return " It looks like the TOML file of a method, but there is no such file."
    if name.lower().endswith((".parquet", ".npz", ".npy")):
        return f" Finished motions are scored with `prbench score {name}`."
    if len(words) > 1 or (words and words[0].lower().endswith(_PROGRAM_SUFFIXES)):
        command = name if len(words) > 1 or not name.lower().endswith(".py") else f"python {name}"
        return f" It looks like a program: give its command as 'cmd:{command}', or a .toml file that holds it."
    if "/" in name or "\\" in name:
        return " It looks like a path: a program is given as 'cmd:COMMAND', a method's own environment as a .toml file."
    return ""


def _adapters() -> Iterator[InstalledAdapter]:
    for distribution in _distributions():
        lines = _lines(distribution, ENTRY_POINT_GROUP)
        if lines:
            package, version = (
                _field(distribution, "Name") or _folder_name(distribution),
                _field(distribution, "Version"),
            )
            for line in lines:
                yield _adapter(line, package or _UNKNOWN, version or _UNKNOWN)


def _adapter(line: str, package: str, version: str) -> InstalledAdapter:
    name, separator, target = (part.strip() for part in line.partition("="))
    if not separator or not name:
        problem = f"entry_points.txt: expected 'name = module:callable', found '{line[:60]}'"
        return InstalledAdapter(name or _UNKNOWN, package, version, target, problem)
    if not _TARGET.fullmatch(target):
        problem = f"entry point: expected 'module:callable', found '{target[:60]}'"
        return InstalledAdapter(name, package, version, target, problem)
    return InstalledAdapter(name, package, version, target)


def _distributions() -> Iterator[Distribution]:
    """Installed packages; of two copies the one that stands first on the path, as an import would find it."""
    seen = set()
    for distribution in distributions():
        name = re.sub(r"[-_.]+", "-", _folder_name(distribution) or _field(distribution, "Name")).lower()
        if name not in seen:
            seen.add(name)
            yield distribution


def _folder_name(distribution: Distribution) -> str:
    """The package's name as its ``.dist-info`` folder has it, which costs no reading."""
    folder = str(getattr(getattr(distribution, "_path", None), "name", ""))
    return folder.partition("-")[0] if folder.endswith((".dist-info", ".egg-info")) else ""


def _field(distribution: Distribution, name: str) -> str:
    """``Name`` or ``Version`` from a package's metadata; empty if they cannot be read."""
    try:
        return str(distribution.metadata.get(name) or "")  # type: ignore[attr-defined]  # an email.message.Message
    except Exception:  # whatever a strange installation raises, the others are still to be listed
        return ""


def _lines(distribution: Distribution, group: str) -> list[str]:
    """The lines of one group of a package's entry points, comments left out."""
    try:
        text = distribution.read_text("entry_points.txt") or ""
    except (OSError, ValueError):  # unreadable, or no UTF-8
        return []
    found, section = [], ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            section = line[1:-1].strip()
        elif line and line[0] not in "#;" and section == group:
            found.append(line)
    return found
