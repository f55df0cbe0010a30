"""``prbench adapters converters``: the converters as one file, for a program of another Python."""

from __future__ import annotations

import argparse
from pathlib import Path

from prbench.cli.arguments import command

_DEFAULT = Path("prbench_converters.py")


def add_parser(group: argparse._SubParsersAction) -> None:
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


def _converters(arguments: argparse.Namespace) -> int:
    from prbench.workflows.scaffold.one_file import write_converters

    write_converters(arguments.out)
    print(f"{arguments.out}: from {arguments.out.stem} import motions_from_features, placed_on")
    return 0
