"""Installed training tasks: listed without importing any, loaded by name.

A task has an entry point of its own, or stands beside a method: then a callable ``training_task`` in the module that
the method's entry point names makes it, and the method needs no second line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from prbench.entry_points import ADAPTERS, PREDICTORS
from prbench.errors import AdapterError, PrbenchError, did_you_mean
from prbench.harness.methods.installed import entry_points_of, list_adapters

ENTRY_POINT_GROUP = "prbench.training_tasks"
_BESIDE_THE_METHOD = "training_task"
"""The callable without arguments that makes the task of a method, in the module of the method's ``load``."""

_DEFINITION = re.compile(rf"^def {_BESIDE_THE_METHOD}\b", re.MULTILINE)


def list_tasks() -> tuple[str, ...]:
    """Names of all installed tasks, without importing any of them."""
    named = {point.name for point in entry_points_of(ENTRY_POINT_GROUP)}
    beside = {point.name for point in _methods() if _defines_a_task(point)}
    return tuple(sorted(named | beside))


def load_task(name: str) -> Any:
    """Import a task: what has a name, configurations and ``build``, as the training loop expects it.

    Raises:
        AdapterError: if there is none of this name (with those that there are), two packages offer it, or it cannot be
            imported.
    """
    point = _find(name)
    origin = f"training task '{name}' ({point.value})"
    try:
        task = point.load()()
    except PrbenchError:
        raise
    except (Exception, SystemExit) as error:
        cause = f"{type(error).__name__}: {error}".rstrip(".")
        raise AdapterError(f"{origin}: cannot be loaded: {cause}. Repair or reinstall the package.") from error
    missing = [part for part in ("name", "configurations", "build") if not hasattr(task, part)]
    if missing:
        raise AdapterError(f"{origin}: expected name, configurations and build(), found no {', '.join(missing)}.")
    return task


def _find(name: str) -> EntryPoint:
    found = [point for point in entry_points_of(ENTRY_POINT_GROUP) if point.name == name]
    if not found:
        found = [_beside(point) for point in _methods() if point.name == name and _defines_a_task(point)]
    if len({point.value for point in found}) > 1:
        offers = ", ".join(point.value for point in found)
        raise AdapterError(f"training task '{name}' is offered more than once: {offers}. Uninstall all but one.")
    if not found:
        known = list_tasks()
        hint = did_you_mean(name, known)
        if any(method.name == name for method in list_adapters()):
            hint = (
                f" The method '{name}' is not trained by this command; if it learns, `prbench run` fits it by itself."
            )
        raise AdapterError(f"nothing to train is called '{name}'.{hint} There are: {', '.join(known) or 'none'}.")
    return found[0]


def _methods() -> Iterator[EntryPoint]:
    """The entry points of all methods, of whichever benchmark."""
    yield from entry_points_of(ADAPTERS)
    yield from entry_points_of(PREDICTORS)


def _beside(method: EntryPoint) -> EntryPoint:
    """The task that stands beside a method, as if it had an entry point."""
    return EntryPoint(method.name, f"{_module(method)}:{_BESIDE_THE_METHOD}", ENTRY_POINT_GROUP)


def _defines_a_task(method: EntryPoint) -> bool:
    """Return True where a method's module defines the callable; its source is read, because a module may be broken."""
    try:
        spec = find_spec(_module(method))
        source = Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin else ""
    except (ImportError, ValueError, OSError):  # no such module, no source, no text: no task
        return False
    return _DEFINITION.search(source) is not None


def _module(point: EntryPoint) -> str:
    return point.value.partition(":")[0].strip()
