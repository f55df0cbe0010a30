"""Find the datasets that can be read: prbench's own and those of installed packages (group ``prbench.readers``).

A package that reads a dataset has one line under ``[project.entry-points."prbench.readers"]``, the dataset's name and
its reader, and the manifest ``<dataset>.toml`` beside the module that the line names. Nothing of a package is imported
to list it.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections import Counter
from collections.abc import Collection
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path

from prbench.entry_points import InstalledEntry, installed_entries
from prbench.errors import UsageError, did_you_mean
from prbench.shown import quoted

ENTRY_POINT_GROUP = "prbench.readers"
# Begins the name under which synthetic recordings of a dataset are kept; they have the layout of real ones.
SYNTHETIC_PREFIX = "synthetic-"
# The same of people of the second world, who are never learnt from.
SECOND_WORLD_PREFIX = "synthetic-second-"
# Follows every table of scores on such recordings.
ON_SYNTHETIC_DATA = "These are scores on synthetic data: never compare them with published ones."

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_LONGEST_NAME = 60
# The dataset of plain recordings; behind the prefix stands the name that a user's own manifest gives them.
OWN = "own"
OWN_PREFIX = "own-"
# Words with another meaning in commands.
_RESERVED = ("all", "synthetic", "list", "new", "check")


def origin_of(reader: InstalledEntry) -> str:
    """Return a reader as messages name it."""
    return f"reader of '{reader.name}' (package {reader.package} {reader.version}, {quoted(reader.target)})"


def installed_readers() -> tuple[InstalledEntry, ...]:
    """List every reader by its dataset's name; those that cannot be used say why."""
    return _readers_on(tuple(sys.path))


def readable_datasets() -> tuple[str, ...]:
    """Return the names of the datasets that have a reader, sorted."""
    return tuple(reader.name for reader in installed_readers() if not reader.problem)


def imitated(dataset: str) -> str:
    """Return the dataset that synthetic recordings imitate; any other name as it is."""
    return dataset.removeprefix(SECOND_WORLD_PREFIX).removeprefix(SYNTHETIC_PREFIX)


def layout_of(dataset: str) -> str:
    """Return the dataset whose reader and manifest serve a table: without ``synthetic-``, and ``own`` for ``own-…``."""
    name = imitated(dataset)
    return OWN if name.startswith(OWN_PREFIX) else name


def find_reader(dataset: str) -> InstalledEntry:
    """Find the reader of a dataset (:func:`layout_of`).

    Raises:
        UsageError: for a dataset without reader, with the nearest known name, or one whose reader cannot be used.
    """
    name = layout_of(dataset)
    claims = [reader for reader in installed_readers() if reader.name == name]
    usable = next((reader for reader in claims if not reader.problem), None)
    if usable is not None:
        return usable
    if claims:
        raise UsageError(f"{origin_of(claims[0])}: {claims[0].problem}. Repair or uninstall the package.")
    known = readable_datasets()
    problem = f"no reader for '{dataset}'.{did_you_mean(name, known)} There are readers for:"
    raise UsageError(f"{problem} {', '.join(known)}.")


def dataset_name_problem(name: str, *, known: Collection[str]) -> str:
    """Say why a package cannot call its dataset so; empty if it can.

    Args:
        name: The name.
        known: Names of the datasets that there are already.
    """
    same = name.replace("-", "")
    taken = next((other for other in sorted(known) if other.replace("-", "") == same), None)
    if not _NAME.fullmatch(name) or len(name) > _LONGEST_NAME:
        form = f"at most {_LONGEST_NAME} characters of a to z, 0 to 9 and single hyphens between them"
        return f"expected a name of {form}, found {quoted(repr(name))}"
    if name in _RESERVED or name.startswith((SYNTHETIC_PREFIX, OWN_PREFIX)):
        return f"'{name}' is a reserved word of prbench"
    return "" if taken is None else f"'{taken}' is a dataset of prbench already; choose another name"


def own_datasets() -> tuple[str, ...]:
    """Return the names of the datasets and corpora whose manifests come with prbench, sorted."""
    files = resources.files("prbench_data_manifests").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def folder_of(reader: InstalledEntry) -> Path:
    """Return the folder of the module that an entry point names, without importing that module.

    The packages around it are imported.

    Raises:
        UsageError: if there is no such module, or a package around it cannot be imported.
    """
    module = reader.target.partition(":")[0].strip()
    try:
        found = importlib.util.find_spec(module)
    except (Exception, SystemExit) as error:
        cause = f"{type(error).__name__}: {error}".rstrip(".")
        problem = f"{origin_of(reader)}: cannot be imported: {cause}."
        raise UsageError(f"{problem} Repair or reinstall the package.") from error
    if found is None or found.origin is None:
        raise UsageError(f"{origin_of(reader)}: there is no module '{module}'. Repair or reinstall the package.")
    return Path(found.origin).parent


@cache
def _readers_on(path: tuple[str, ...]) -> tuple[InstalledEntry, ...]:  # noqa: ARG001
    """See :func:`installed_readers`; readers are asked for often, and the metadata change with the path alone."""
    entries = list(installed_entries(ENTRY_POINT_GROUP, kind="READER"))
    own = {entry.name for entry in entries if entry.built_in} | set(own_datasets())
    readers = []
    for entry in entries:
        problem = entry.problem
        if not problem and not entry.built_in:
            problem = dataset_name_problem(entry.name, known=own)
        name = entry.name if _NAME.fullmatch(entry.name) else quoted(entry.name or "unknown")
        readers.append(replace(entry, name=name, problem=problem))
    # One that another package offers, too, is refused.
    claims = Counter(reader.name for reader in readers if not reader.problem)
    for place, reader in enumerate(readers):
        if not reader.problem and claims[reader.name] > 1:
            packages = sorted({other.package for other in readers if other.name == reader.name})
            readers[place] = replace(reader, problem=f"it is offered more than once, by {' and '.join(packages)}")
    return tuple(sorted(readers))
