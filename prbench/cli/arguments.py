"""Arguments that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

CONDITIONS = ("none", "text", "goal-pose", "goal-loc")
"""Conditions that a method can be given; spelt out here, so that ``--help`` imports no arrays."""
FIRST_RUN_SEQUENCES = 48
"""Limit of a run on the embedded dataset (``prbench.workflows.first_run``); spelt out for the same reason."""


def command(
    commands: argparse._SubParsersAction,
    name: str,
    *,
    summary: str,
    example: str,
    execute: Callable[[argparse.Namespace], int],
    resumes: bool = False,
) -> argparse.ArgumentParser:
    """Add one command with a help page that ends in an example; say whether it takes up what Ctrl-C has left."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(execute=execute, resumes=resumes)
    return parser


def add_data(parser: argparse.ArgumentParser, *, required: bool, help: str = "built dataset folder(s)") -> None:
    """Add ``--data DIR…``, repeatable."""
    parser.add_argument(
        "--data", type=Path, nargs="+", action="extend", metavar="DIR", default=None, required=required, help=help
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add ``--workers N``; results do not depend on it."""
    parser.add_argument(
        "--workers", type=positive, default=1, metavar="N", help="processes to use (default 1); changes no result"
    )


def add_split(parser: argparse.ArgumentParser) -> None:
    """Add ``--split``; the test split unless another is named."""
    parser.add_argument("--split", choices=["train", "validation", "test"], default="test", help="default: test")


def add_limit(parser: argparse.ArgumentParser, *, default: str = "all") -> None:
    """Add ``--limit N`` sequences of each dataset; equal limits mean the same sequences in every command.

    Commands that count recordings or motions have options of their own (:func:`prbench.cli.builds.add_recordings`).
    """
    parser.add_argument(
        "--limit",
        type=positive,
        metavar="N",
        help="at most N sequences of each dataset, for every command the same: those whose ids have the smallest"
        f" SHA-256 (default: {default})",
    )


def add_method_settings(parser: argparse.ArgumentParser) -> None:
    """Add what a method is loaded with: ``--weights``, ``--option``, ``--device`` and ``--threads``."""
    parser.add_argument(
        "--weights",
        type=Path,
        metavar="NAME|FILE",
        help="the method's weights: bundled ones by name, a file or a folder",
    )
    parser.add_argument(
        "--option", type=key_value, action="append", default=[], metavar="KEY=VALUE", help="for the method; repeatable"
    )
    parser.add_argument("--device", default="cpu", help="cpu (default), cuda, cuda:1 …")
    parser.add_argument("--threads", type=positive, default=1, metavar="N", help="threads a worker (default 1)")


def add_permission(parser: argparse.ArgumentParser) -> None:
    """Add ``--permission DATASET``, repeatable: the user's word for data whose licence keeps recorded motion."""
    parser.add_argument(
        "--permission",
        action="append",
        default=[],
        metavar="DATASET",
        help="I have the licensor's permission to pass on recorded motion and goals of DATASET (only needed where its"
        " licence forbids it; `prbench datasets` says which); repeatable",
    )


def positive(text: str) -> int:
    """Parse a whole number of at least 1."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, found '{text}'")
    return value


def key_value(text: str) -> tuple[str, str]:
    """Parse ``key=value``."""
    key, separator, value = text.partition("=")
    if not separator or not key:
        raise argparse.ArgumentTypeError(f"expected key=value, found '{text}'")
    return key, value
