"""``prbench adapters``: the installed methods, from metadata alone; beside it ``new``, ``check`` and ``converters``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from prbench.cli import adapters_check, adapters_converters, adapters_new
from prbench.cli.adapters_details import print_details
from prbench.cli.arguments import command, positive
from prbench.cli.columns import print_columns

if TYPE_CHECKING:
    from prbench.methods.installed import InstalledAdapter

_EXAMPLE = "prbench adapters list"


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command group."""
    summary = "list the installed methods, start a new one, check one"
    parser = command(commands, "adapters", summary=summary, example=_EXAMPLE, execute=_list)
    parser.set_defaults(details=False, as_json=False, names=[])
    group = parser.add_subparsers(metavar="COMMAND")
    _add_list(group)
    adapters_new.add_parser(group)
    adapters_check.add_parser(group)
    adapters_converters.add_parser(group)


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


def _list(arguments: argparse.Namespace) -> int:
    from prbench.methods.installed import list_adapters, no_such_method

    found = list_adapters()
    known = {adapter.name for adapter in found}
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        raise no_such_method(unknown[0], known)
    if arguments.details:
        print_details(arguments.names, time_limit=float(arguments.time_limit), as_json=arguments.as_json)
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
    """What keeps a method from being used, as far as metadata tell."""
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
