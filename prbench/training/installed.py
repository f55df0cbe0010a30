"""Installed training tasks: listed from package metadata alone, loaded by name."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING

from prbench.errors import AdapterError, PrbenchError, did_you_mean
from prbench.evaluation.installed import entry_points_of, list_adapters

if TYPE_CHECKING:
    from prbench.training.task import TrainingTask

ENTRY_POINT_GROUP = "prbench.training_tasks"


def list_tasks() -> tuple[str, ...]:
    """Names of all installed tasks, without importing any of them."""
    return tuple(sorted({point.name for point in entry_points_of(ENTRY_POINT_GROUP)}))


def load_task(name: str) -> TrainingTask:
    """Import a task.

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
