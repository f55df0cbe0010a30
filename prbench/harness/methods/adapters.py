"""Installed methods: found by name, imported and made, and the weights that they use."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from enum import StrEnum
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from prbench.entry_points import ADAPTERS
from prbench.errors import AdapterError, PrbenchError, UsageError
from prbench.files.storage import file_digest
from prbench.harness.methods.declared import Declared
from prbench.harness.methods.groups import MOTIONS, MethodGroup
from prbench.harness.methods.installed import InstalledEntry, list_adapters, no_such_method
from prbench.harness.methods.python_files import find_python_method, is_python_method, python_loader
from prbench.protocol.benchmarks import benchmarks


def find_adapter(name: str, *, also_known: Iterable[str] = (), entry_points: str = ADAPTERS) -> InstalledEntry:
    """Find the installed method of this name: prbench's own, or the one that a single package offers.

    A Python file and ``module:function`` are found without being installed
    (:mod:`prbench.harness.methods.python_files`).

    Args:
        name: As given by ``--method``.
        also_known: Further names that may be meant, such as those of controls.
        entry_points: Entry-point group, which is that of one benchmark.

    Raises:
        AdapterError: if there is none (with the nearest name), two packages offer it, or its metadata are damaged.
    """
    if is_python_method(name):
        return find_python_method(name)
    installed = list_adapters(entry_points)
    claims = [adapter for adapter in installed if adapter.name == name]
    found = [adapter for adapter in claims if not adapter.problem]
    if len(found) > 1:
        offers = ", ".join(f"{adapter.target} of {adapter.package} {adapter.version}" for adapter in found)
        raise AdapterError(f"adapter '{name}' is offered more than once: {offers}. Uninstall all but one.")
    if found:
        return found[0]
    if claims:
        raise AdapterError(
            f"adapter '{name}' (package {claims[0].package}): {claims[0].problem}."
            " Repair the entry point, or reinstall the package."
        )
    for other in benchmarks().values():
        elsewhere = {adapter.name for adapter in list_adapters(other.entry_points) if not adapter.problem}
        if other.entry_points != entry_points and name in elsewhere:
            raise AdapterError(
                f"'{name}' is a method of the benchmark {other.name}, which is not the one asked for here:"
                f" `prbench run --benchmark {other.name} --method {name}` runs it."
            )
    raise no_such_method(name, [*(adapter.name for adapter in installed), *also_known])


def load_adapter(
    name: str, weights: Path | None, options: Mapping[str, str], device: str, *, group: MethodGroup = MOTIONS
) -> Any:
    """Import a method and make it.

    Args:
        name: Name of the entry point.
        weights: File or folder, or None for the method's default.
        options: ``--option key=value``, handed on as they are.
        device: ``cpu``, ``cuda`` …
        group: The methods of one benchmark.

    Raises:
        AdapterError: if it is not installed, cannot be imported, refuses an option, or is no adapter; the message
            names the package and the cause.
    """
    installed = find_adapter(name, entry_points=group.entry_points)
    point = EntryPoint(installed.name, installed.target, group.entry_points)
    origin = f"adapter '{name}' (package {installed.package} {installed.version}, {installed.target})"
    try:
        load = python_loader(name) if is_python_method(name) else point.load()
    except (Exception, SystemExit) as error:
        raise AdapterError(
            f"{origin}: cannot be imported: {_cause(error)}. Repair or reinstall the package."
        ) from error
    try:
        adapter = load(weights, options=dict(options), device=device)
    except PrbenchError:
        raise
    except ValueError as error:
        raise AdapterError(f"{origin}: refused its settings: {error}") from error
    except (Exception, SystemExit) as error:
        raise AdapterError(f"{origin}: cannot be loaded: {_cause(error)}.") from error
    if not isinstance(adapter, group.interface):
        raise AdapterError(f"{origin}: expected an object with {group.members}, found {type(adapter).__name__}.")
    Declared.by(adapter, origin=origin, conditions=group.conditions)
    return adapter


def chosen_condition(name: str, adapter: Any, condition: StrEnum | None, *, group: MethodGroup = MOTIONS) -> Any:
    """Return the condition that a method is run under: the one asked for, or the only one that it takes.

    Raises:
        AdapterError: if the method does not take it, or none is asked for and it takes several; names those that it
            takes.
    """
    conditions = Declared.by(adapter, origin=f"adapter '{name}'", conditions=group.conditions).conditions
    if condition is not None and condition in conditions:
        return condition
    if condition is None and len(conditions) == 1:
        return next(iter(conditions))
    taken = ", ".join(sorted(item.value for item in conditions))
    if condition is None:
        raise AdapterError(f"adapter '{name}' takes several conditions. Choose one with --condition: {taken}.")
    raise AdapterError(f"adapter '{name}' does not take the condition '{condition.value}'. Choose one of: {taken}.")


def used_weights(adapter: Any, condition: StrEnum, given: Path | None, *, origin: str) -> Path | None:
    """Return the weights used under a condition: those the method names itself (``weights_for``), else those given.

    Raises:
        AdapterError: if it names something that is no path.
    """
    weights_for = getattr(adapter, "weights_for", None)
    if weights_for is None:
        return given
    weights = weights_for(condition)
    if weights is None or isinstance(weights, Path):
        return weights
    raise AdapterError(f"{origin}: expected weights_for() to return a pathlib.Path or None, found {weights!r}.")


def require_weights(weights: Path | None) -> None:
    """Refuse a path that does not exist; a single word may be a name that the method knows.

    Raises:
        UsageError: if it is neither.
    """
    if weights is not None and not weights.exists() and (len(weights.parts) > 1 or weights.suffix):
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")


def weights_digest(weights: Path | None) -> str | None:
    """Return the SHA-256 of a weights file, or of the names and contents of a folder.

    Raises:
        UsageError: if the path does not exist.
    """
    if weights is None:
        return None
    if weights.is_file():
        return file_digest(weights)
    if not weights.is_dir():
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")
    total = hashlib.sha256()
    # Sorted, so that the digest does not depend on the file system.
    for path in sorted(path for path in weights.rglob("*") if path.is_file()):
        total.update(f"{path.relative_to(weights).as_posix()}\t{file_digest(path)}\n".encode())
    return total.hexdigest()


def _cause(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".rstrip(".")
