"""Package metadata of installed methods, read so that one damaged package never hides the others.

``importlib.metadata.entry_points`` gives up on the first line that it cannot parse, and with it every command that
names a method. Here each package is read by itself, and what is wrong with it is said beside its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import Distribution, EntryPoint, distributions

from prbench.contract import ENTRY_POINT_GROUP
from prbench.errors import AdapterError, did_you_mean
from prbench.methods.names import BUILT_IN_METHODS, has_form, name_problem
from prbench.shown import quoted

_OURS = "prbench"  # the distribution whose methods are built in
_UNKNOWN = "unknown"
_TARGET = re.compile(r"[A-Za-z_][\w.]*\s*:\s*[A-Za-z_][\w.]*\s*(\[.*\])?")
_PROGRAM_SUFFIXES = (".py", ".js", ".mjs", ".sh", ".exe", ".jl", ".rb", ".r", ".m")


@dataclass(frozen=True, order=True)
class InstalledAdapter:
    """The package metadata of a method; nothing of it was imported."""

    name: str
    package: str
    version: str
    target: str
    """``module:callable``."""
    problem: str = ""
    """Reason why the method cannot be used: damaged metadata, or a name that is not its own; empty if it can."""
    built_in: bool = False
    """True if it comes with prbench itself."""


def list_adapters() -> list[InstalledAdapter]:
    """Return all installed methods by name, without importing any; those that cannot be used say why."""
    return sorted(set(_adapters()))


def offered_twice(adapters: Iterable[InstalledAdapter]) -> frozenset[str]:
    """Return names that several packages offer; such a name cannot be used until all but one are uninstalled."""
    names = [adapter.name for adapter in adapters if not adapter.problem]
    return frozenset(name for name in names if names.count(name) > 1)


def entry_points_of(group: str) -> Iterator[EntryPoint]:
    """Yield the readable entry points of a group, but none whose name belongs to prbench."""
    for distribution in _distributions():
        for line in _lines(distribution, group):
            name, separator, value = (part.strip() for part in line.partition("="))
            if separator and name and value and (_is_ours(distribution) or name_problem(name) is None):
                yield EntryPoint(name, value, group)


def no_such_method(name: str, known: Iterable[str]) -> AdapterError:
    """Return the error for an unknown method: it names the nearest known one, or how a program or a file is given."""
    hint = did_you_mean(name, known) or _as_program(name)
    return AdapterError(f"adapter '{name}' is not installed.{hint} `prbench adapters list` shows all of them.")


def _as_program(name: str) -> str:
    """Return a hint for what looks like a program, a file of its results, or a command."""
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
                adapter = _adapter(line, quoted(package or _UNKNOWN), quoted(version or _UNKNOWN))
                yield _with_right_to_its_name(adapter, ours=_is_ours(distribution))


def _with_right_to_its_name(adapter: InstalledAdapter, *, ours: bool) -> InstalledAdapter:
    """Mark the method as built in, or as refused where its name belongs to prbench or cannot be shown."""
    if ours and adapter.name in BUILT_IN_METHODS:
        return replace(adapter, built_in=True)
    problem = adapter.problem or name_problem(adapter.name) or ""
    name = adapter.name if has_form(adapter.name) else quoted(adapter.name)
    return replace(adapter, name=name, problem=problem)


def _is_ours(distribution: Distribution) -> bool:
    return _normalised(distribution) == _OURS


def _adapter(line: str, package: str, version: str) -> InstalledAdapter:
    name, separator, target = (part.strip() for part in line.partition("="))
    if not separator or not name:
        problem = f"entry_points.txt: expected 'name = module:callable', found '{quoted(line, longest=60)}'"
        return InstalledAdapter(name or _UNKNOWN, package, version, target, problem)
    if not _TARGET.fullmatch(target):
        problem = f"entry point: expected 'module:callable', found '{quoted(target, longest=60)}'"
        return InstalledAdapter(name, package, version, target, problem)
    return InstalledAdapter(name, package, version, target)


def _distributions() -> Iterator[Distribution]:
    """Yield installed packages; of two copies the one that stands first on the path, as an import would find it."""
    seen = set()
    for distribution in distributions():
        name = _normalised(distribution)
        if name not in seen:
            seen.add(name)
            yield distribution


def _normalised(distribution: Distribution) -> str:
    return re.sub(r"[-_.]+", "-", _folder_name(distribution) or _field(distribution, "Name")).lower()


def _folder_name(distribution: Distribution) -> str:
    """Return the package's name as its ``.dist-info`` folder has it, which costs no reading.

    A source checkout has ``name.egg-info`` without a version.
    """
    stem, _, suffix = str(getattr(getattr(distribution, "_path", None), "name", "")).rpartition(".")
    return stem.partition("-")[0] if suffix in ("dist-info", "egg-info") else ""


def _field(distribution: Distribution, name: str) -> str:
    """Return ``Name`` or ``Version`` from a package's metadata; empty if they cannot be read."""
    try:
        return str(distribution.metadata.get(name) or "")  # type: ignore[attr-defined]  # an email.message.Message
    except Exception:  # whatever a strange installation raises, the others are still to be listed
        return ""


def _lines(distribution: Distribution, group: str) -> list[str]:
    """Return the lines of one group of a package's entry points, comments left out."""
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
