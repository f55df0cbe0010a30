"""``prbench adapters``: the installed methods, from metadata alone; beside it ``new``, ``check`` and ``converters``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli import adapters_check
from prbench.cli.arguments import CONDITIONS, command, positive
from prbench.cli.terminal import print_columns

if TYPE_CHECKING:
    from prbench.methods.describe import Description
    from prbench.methods.installed import InstalledAdapter

_EXAMPLE = "prbench adapters list"
_DEFAULT = Path("prbench_converters.py")


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command group."""
    summary = "list the installed methods, start a new one, check one"
    parser = command(commands, "adapters", summary=summary, example=_EXAMPLE, execute=_list)
    parser.set_defaults(details=False, as_json=False, names=[])
    group = parser.add_subparsers(metavar="COMMAND")
    _add_list(group)
    _add_new(group)
    adapters_check.add_parser(group)
    _add_converters(group)


def _add_list(group: argparse._SubParsersAction) -> None:
    parser = command(
        group,
        "list",
        summary="list the installed methods with their packages, without importing any of them",
        example="prbench adapters list --details",
        execute=_list,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these methods (default: all)")
    parser.add_argument(
        "--details",
        action="store_true",
        help="import each in a process of its own and show its conditions, whether it trains, its limits and weights,"
        " or its error",
    )
    parser.add_argument(
        "--time-limit", type=positive, default=30, metavar="SECONDS", help="for each import (default 30)"
    )
    parser.add_argument("--json", dest="as_json", action="store_true", help="print JSON")


def _add_new(group: argparse._SubParsersAction) -> None:
    """Register the command under ``prbench adapters``."""
    parser = command(
        group,
        "new",
        summary="write a complete package with a new method that works at once, for you to change",
        example="prbench adapters new glide --condition goal-loc",
        execute=_new,
    )
    parser.add_argument("name", metavar="NAME", help="of the method, such as glide: what --method will be given")
    parser.add_argument("--out", type=Path, metavar="DIR", help="new folder (default: ./prbench-NAME, or ./NAME)")
    parser.add_argument(
        "--condition",
        choices=CONDITIONS,
        action="append",
        default=[],
        help="what the method is given (default goal-loc); repeatable",
    )
    parser.add_argument("--trainable", action="store_true", help="with fit(): a method that learns from a table")
    parser.add_argument(
        "--program",
        action="store_true",
        help="a program of its own instead of a package: one plain Python file and a TOML file",
    )


def _add_converters(group: argparse._SubParsersAction) -> None:
    """Register the command under ``prbench adapters``."""
    parser = command(
        group,
        "converters",
        summary="write the converters as one file for a program: NumPy only, Python 3.8 or later",
        example="prbench adapters converters --out glide/prbench_converters.py",
        execute=_converters,
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=_DEFAULT,
        metavar="FILE",
        help=f"the file, beside the program (default ./{_DEFAULT})",
    )


def _list(arguments: argparse.Namespace) -> int:
    from prbench.methods.installed import list_adapters, no_such_method

    found = list_adapters()
    known = {adapter.name for adapter in found}
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        raise no_such_method(unknown[0], known)
    if arguments.details:
        _print_details(arguments.names, time_limit=float(arguments.time_limit), as_json=arguments.as_json)
        return 0
    shown = [adapter for adapter in found if not arguments.names or adapter.name in arguments.names]
    if arguments.as_json:
        print(json.dumps([_plain(adapter, found) for adapter in shown], indent=2))
        return 0
    rows = [("name", "package", "version", "target", "")]
    rows += [(a.name, a.package, a.version, a.target, _remark(a, found)) for a in shown]
    print_columns(rows)
    return 0


def _remark(adapter: InstalledAdapter, found: Sequence[InstalledAdapter]) -> str:
    """Say what keeps a method from being used, as far as metadata tell."""
    from prbench.methods.installed import offered_twice

    if adapter.problem:
        return f"! {adapter.problem}"
    return "! offered more than once: uninstall all but one" if adapter.name in offered_twice(found) else ""


def _plain(adapter: InstalledAdapter, found: Sequence[InstalledAdapter]) -> dict[str, str]:
    return {
        "name": adapter.name,
        "package": adapter.package,
        "version": adapter.version,
        "target": adapter.target,
        "problem": _remark(adapter, found).removeprefix("! "),
    }


def _print_details(names: Sequence[str], *, time_limit: float, as_json: bool) -> None:
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


def _new(arguments: argparse.Namespace) -> int:
    from prbench.workflows.scaffold import ScaffoldRequest, new_adapter

    request = ScaffoldRequest(
        name=arguments.name,
        conditions=tuple(arguments.condition) or ("goal-loc",),
        out=arguments.out,
        trainable=arguments.trainable,
        program=arguments.program,
    )
    report = new_adapter(request)
    for warning in report.warnings:
        print(f"prbench: {warning}", file=sys.stderr)
    print(f"{report.folder}: {len(report.files)} files. Next:")
    for step in report.next_steps:
        print(f"  {step}")
    return 0


def _converters(arguments: argparse.Namespace) -> int:
    from prbench.workflows.scaffold.one_file import write_converters

    write_converters(arguments.out)
    print(f"{arguments.out}: from {arguments.out.stem} import motions_from_features, placed_on")
    return 0
