"""Installed methods: listed from package metadata alone, loaded by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from prbench.contract import ENTRY_POINT_GROUP, Adapter, Condition
from prbench.errors import AdapterError, PrbenchError, did_you_mean
from prbench.evaluation.declared import Declared


@dataclass(frozen=True, order=True)
class InstalledAdapter:
    """What package metadata say about a method; nothing of it was imported."""

    name: str
    package: str
    version: str
    target: str
    """``module:callable``."""


def list_adapters() -> list[InstalledAdapter]:
    """All installed methods by name, without importing any of them."""
    return sorted({_described(point) for point in entry_points(group=ENTRY_POINT_GROUP)})


def find_adapter(name: str, *, also_known: Iterable[str] = ()) -> InstalledAdapter:
    """The installed method of this name.

    Args:
        name: As given by ``--method``.
        also_known: Further names that may be meant, such as those of controls.

    Raises:
        AdapterError: if there is none (with the nearest name), or two packages offer it.
    """
    installed = list_adapters()
    found = [adapter for adapter in installed if adapter.name == name]
    if len(found) > 1:
        offers = ", ".join(f"{adapter.target} of {adapter.package} {adapter.version}" for adapter in found)
        raise AdapterError(f"adapter '{name}' is offered more than once: {offers}. Uninstall all but one.")
    if found:
        return found[0]
    known = [adapter.name for adapter in installed] + list(also_known)
    hint = did_you_mean(name, known)
    raise AdapterError(f"adapter '{name}' is not installed.{hint} `prbench adapters list` shows all of them.")


def load_adapter(name: str, weights: Path | None, options: Mapping[str, str], device: str) -> Adapter:
    """Import a method and make it.

    Args:
        name: Of the entry point.
        weights: File or folder, or None for the method's default.
        options: ``--option key=value``, handed on as they are.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if it is not installed, cannot be imported, refuses an option, or is no adapter; the message
            names the package and the cause.
    """
    installed = find_adapter(name)
    point = next(point for point in entry_points(group=ENTRY_POINT_GROUP) if _described(point) == installed)
    origin = f"adapter '{name}' (package {installed.package} {installed.version}, {installed.target})"
    try:
        load = point.load()
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
    if not isinstance(adapter, Adapter):
        raise AdapterError(
            f"{origin}: expected an object with name, conditions and generate(), found {type(adapter).__name__}."
        )
    Declared.by(adapter, origin=origin)
    return adapter


def require_condition(name: str, adapter: Adapter, condition: Condition) -> None:
    """Refuse a condition that a method does not take.

    Raises:
        AdapterError: naming the conditions that it does take.
    """
    conditions = Declared.by(adapter, origin=f"adapter '{name}'").conditions
    if condition not in conditions:
        taken = ", ".join(sorted(item.value for item in conditions))
        raise AdapterError(f"adapter '{name}' does not take the condition '{condition.value}'. Choose one of: {taken}.")


def _described(point: EntryPoint) -> InstalledAdapter:
    package, version = (point.dist.name, point.dist.version) if point.dist else ("unknown", "unknown")
    return InstalledAdapter(point.name, package, version, point.value)


def _cause(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".rstrip(".")
