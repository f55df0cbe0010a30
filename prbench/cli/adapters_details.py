"""What ``prbench adapters list --details`` prints."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from prbench.cli.columns import print_columns

if TYPE_CHECKING:
    from prbench.methods.describe import Description


def print_details(names: Sequence[str], *, time_limit: float, as_json: bool) -> None:
    """Import the methods, each in a process of its own, and print what they declare or why they cannot be used.

    Args:
        names: Of methods; empty for all, and then the controls are shown, too.
        time_limit: Seconds for each.
        as_json: Print JSON instead of a table.
    """
    from prbench.evaluation.controls import CONTROLS
    from prbench.methods.describe import describe_adapters
    from prbench.training.installed import list_tasks

    described = describe_adapters(names or None, time_limit=time_limit)
    tasks = list_tasks()
    if as_json:
        print(json.dumps([_plain_details(one, tasks) for one in described], indent=2))
        return
    rows = [("name", "package", "conditions", "trains", "frames", "rate", "weights", "import + load")]
    rows += [_details_row(one, tasks) for one in described if not one.error]
    print_columns(rows)
    for one in described:
        if one.error:
            print(f"! {one.method.name} ({one.method.package} {one.method.version}): {one.error}")
    if not names:
        print("\ncontrols, part of prbench:")
        print_columns([(f"{control.use} {control.name}", control.summary) for control in CONTROLS])


def _trains(description: Description, tasks: Sequence[str]) -> str:
    if description.method.name in tasks and description.method.package == "prbench":
        return "prbench train"
    return "by the run" if description.fitted else "no"


def _details_row(one: Description, tasks: Sequence[str]) -> tuple[str, ...]:
    return (
        one.method.name,
        f"{one.method.package} {one.method.version}",
        ", ".join(one.conditions),
        _trains(one, tasks),
        f"<= {one.max_frames}" if one.max_frames else "any",
        f"{one.native_fps:g}/s" if one.native_fps else "any",
        ", ".join(one.weights) or "none",
        f"{one.import_seconds or 0:.1f} + {one.load_seconds or 0:.1f} s",
    )


def _plain_details(one: Description, tasks: Sequence[str]) -> dict[str, object]:
    return {
        "name": one.method.name,
        "package": one.method.package,
        "version": one.method.version,
        "target": one.method.target,
        "conditions": list(one.conditions),
        "trains": _trains(one, tasks),
        "max_frames": one.max_frames,
        "native_fps": one.native_fps,
        "motionless": one.motionless,
        "weights": list(one.weights),
        "import_seconds": one.import_seconds,
        "load_seconds": one.load_seconds,
        "printed_bytes": one.printed,
        "error": one.error,
    }
