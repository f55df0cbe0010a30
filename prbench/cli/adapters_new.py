"""``prbench adapters new``: a package, or a program, with a new method that works before anything is changed."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from prbench.cli.arguments import CONDITIONS, command


def add_parser(group: argparse._SubParsersAction) -> None:
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
