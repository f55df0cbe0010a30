"""Installed methods as package metadata name them (:mod:`prbench.entry_points`), and who may use which name."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint

from prbench.entry_points import ADAPTERS, InstalledEntry, installed_entries
from prbench.errors import AdapterError, did_you_mean
from prbench.harness.methods.names import has_form, name_problem
from prbench.protocol.benchmarks import benchmark_of_group
from prbench.shown import quoted

_UNKNOWN = "unknown"
_PROGRAM_SUFFIXES = (".py", ".js", ".mjs", ".sh", ".exe", ".jl", ".rb", ".r", ".m")


def list_adapters(entry_points: str = ADAPTERS) -> list[InstalledEntry]:
    """Return all installed methods by name, without importing any; those that cannot be used say why.

    Args:
        entry_points: Entry-point group, which is that of one benchmark.
    """
    return sorted(set(_adapters(entry_points)))


def offered_twice(adapters: Iterable[InstalledEntry]) -> frozenset[str]:
    """Return names that several packages offer; such a name cannot be used until all but one are uninstalled."""
    names = [adapter.name for adapter in adapters if not adapter.problem]
    return frozenset(name for name in names if names.count(name) > 1)


def packages_of(names: Collection[str], entry_points: str = ADAPTERS) -> tuple[str, ...]:
    """Return the distributions that offer some methods, without prbench itself.

    Args:
        names: Of methods; those that are not installed are passed over.
        entry_points: See :func:`list_adapters`.
    """
    installed = list_adapters(entry_points)
    return tuple(each.package for each in installed if each.name in names and not (each.built_in or each.problem))


def entry_points_of(group: str) -> Iterator[EntryPoint]:
    """Yield the readable entry points of a group, but none whose name belongs to prbench."""
    for entry in installed_entries(group):
        if entry.name and entry.target and (entry.built_in or name_problem(entry.name) is None):
            yield EntryPoint(entry.name, entry.target, group)


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


def _adapters(entry_points: str) -> Iterator[InstalledEntry]:
    own = benchmark_of_group(entry_points).methods
    for entry in installed_entries(entry_points):
        name = entry.name or _UNKNOWN
        if entry.built_in and name in own:
            yield entry
            continue
        problem = entry.problem or name_problem(name, own=own) or ""
        # A name that cannot be shown safely is quoted, so that a list stays readable.
        yield replace(entry, name=name if has_form(name) else quoted(name), problem=problem, built_in=False)
