"""``python -m prbench.harness.methods.describe_child NAME BENCHMARK FILE``: write what a method declares.

Each step is put down before it is taken, so that whoever started this process knows how far it came.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import sys
import time
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
from typing import Any

from prbench.errors import PrbenchError
from prbench.harness.methods.adapters import find_adapter, load_adapter
from prbench.harness.methods.declared import Declared
from prbench.harness.methods.groups import MethodGroup, group_of
from prbench.harness.methods.installed import InstalledEntry


def main(name: str, benchmark: str, report: Path) -> None:
    """Import, load and ask the method; ends the process at once, without waiting for threads that it may have left."""
    group = group_of(benchmark)
    method = find_adapter(name, entry_points=group.entry_points)
    _write(report, stage="import")
    started = time.perf_counter()
    try:
        importlib.import_module(method.target.partition(":")[0].strip())
    except BaseException as error:  # a plug-in may raise anything, SystemExit and KeyboardInterrupt too
        said = f"cannot be imported: {type(error).__name__}: {error}".rstrip(".: ")
        _write(report, error=said + _remedy(error, method))
        return
    imported = time.perf_counter()
    _write(report, stage="load", import_seconds=round(imported - started, 3))
    try:
        adapter = load_adapter(name, None, {}, "cpu", group=group)
        _write(report, load_seconds=round(time.perf_counter() - imported, 3), **declarations(adapter, group))
    except PrbenchError as error:
        said = str(error).removeprefix(_origin(method)).rstrip(".")
        _write(report, error=said + _remedy(error.__cause__, method))
    except BaseException as error:
        _write(report, error=f"{type(error).__name__}: {error}")


def declarations(adapter: Any, group: MethodGroup) -> dict:
    """Return the declarations of a method as plain values."""
    declared = Declared.by(adapter, origin="it", conditions=group.conditions)
    return {
        "conditions": sorted(condition.value for condition in declared.conditions),
        "fitted": hasattr(adapter, "fit"),
        "max_frames": declared.max_frames,
        "native_fps": declared.native_fps,
        "motionless": declared.motionless,
        "weights": _weights(adapter, declared.conditions),
    }


def _weights(adapter: Any, conditions: frozenset[StrEnum]) -> list[str]:
    weights_for = getattr(adapter, "weights_for", None)
    paths = [weights_for(condition) for condition in sorted(conditions)] if weights_for is not None else []
    return sorted({Path(path).name for path in paths if path is not None})


def _origin(method: InstalledEntry) -> str:
    return f"adapter '{method.name}' (package {method.package} {method.version}, {method.target}): "


def _remedy(error: BaseException | None, method: InstalledEntry) -> str:
    """Say how to install a module that is missing, if the package's own metadata tell."""
    if not isinstance(error, ModuleNotFoundError) or not error.name:
        return ""
    missing = error.name.partition(".")[0]
    for requirement in _requirements(method.package):
        package = re.match(r"[\w.-]+", requirement)
        if package is None or _normalised(package[0]) != _normalised(missing):
            continue
        extra = re.search(r"extra\s*==\s*['\"]([\w.-]+)['\"]", requirement)
        wanted = f"{method.package}[{extra[1]}]" if extra else package[0]
        return f". Run: pip install '{wanted}'"
    return f". The package does not say what brings the module '{missing}'; see its documentation"


def _requirements(package: str) -> list[str]:
    try:
        return requires(package) or []
    except PackageNotFoundError:
        return []


def _normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _write(report: Path, **values: object) -> None:
    with open(report, "a", encoding="utf-8") as file:
        file.write(json.dumps(values) + "\n")


if __name__ == "__main__":
    sys.dont_write_bytecode = True  # looking at a method leaves no files in its package
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
    os._exit(0)
