"""``prbench adapters list``: which methods are installed, from package metadata alone."""

from __future__ import annotations

import argparse

from prbench.cli.arguments import command


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command group."""
    parser = command(
        commands,
        "adapters",
        summary="show the installed methods",
        example="prbench adapters list",
        execute=_list,
    )
    group = parser.add_subparsers(metavar="COMMAND")
    command(
        group,
        "list",
        summary="list the installed methods with their packages, without importing any of them",
        example="prbench adapters list",
        execute=_list,
    )


def _list(_arguments: argparse.Namespace) -> int:
    from prbench.evaluation.adapters import list_adapters

    found = list_adapters()
    widths = [
        max([len(title), *(len(getattr(row, title)) for row in found)]) for title in ("name", "package", "version")
    ]
    for row in [("name", "package", "version", "target"), *((a.name, a.package, a.version, a.target) for a in found)]:
        print("  ".join(f"{cell:<{width}}" for cell, width in zip(row, [*widths, 0])).rstrip())
    return 0
