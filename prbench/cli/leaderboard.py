"""``prbench leaderboard export``: finished runs side by side."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from prbench.cli.arguments import command

_EXAMPLE = "prbench leaderboard export runs/static runs/ground-truth --format md --out leaderboard.md"


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command group."""
    parser = command(
        commands,
        "leaderboard",
        summary="put finished runs side by side",
        example=_EXAMPLE,
        execute=lambda _: (parser.print_help(), 2)[1],
    )
    group = parser.add_subparsers(metavar="COMMAND")
    export = command(
        group,
        "export",
        summary="write a leaderboard of finished runs",
        example=_EXAMPLE,
        execute=_export,
    )
    export.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="run folders, or folders that hold some")
    export.add_argument("--format", choices=["md", "csv", "json"], default="md", help="default: md")
    export.add_argument("--out", type=Path, metavar="FILE", help="write it there instead of printing it")


def _export(arguments: argparse.Namespace) -> int:
    from prbench.leaderboard import collect_runs, export, make_leaderboard
    from prbench.storage import atomic_path

    collected = collect_runs(arguments.runs)
    for reason in collected.left_out:
        print(f"left out: {reason}", file=sys.stderr)
    text = export(make_leaderboard(collected), arguments.format)
    if arguments.out is None:
        print(text, end="")
        return 0
    with atomic_path(arguments.out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    print(f"leaderboard: {arguments.out}")
    return 0
