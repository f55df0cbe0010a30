"""``prbench``: find the command, run it, and turn a user's error into one message and an exit code."""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence

import prbench
from prbench.cli import (
    adapters,
    build_corpus,
    build_dataset,
    candidates,
    datasets,
    diff,
    doctor,
    evaluate_text,
    explain,
    export_conditions,
    inspect,
    leaderboard,
    poses,
    release,
    run,
    score,
    stats,
    synthesize,
    train,
    validate,
    view,
)
from prbench.cli.terminal import clean_output
from prbench.errors import PrbenchError
from prbench.limits import LONGEST_MESSAGE

_COMMANDS = (
    run,
    view,
    inspect,
    build_dataset,
    build_corpus,
    candidates,
    poses,
    datasets,
    stats,
    diff,
    explain,
    synthesize,
    export_conditions,
    score,
    evaluate_text,
    train,
    leaderboard,
    release,
    adapters,
    doctor,
    validate,
)

_EXAMPLES = """\
examples:
  prbench run --method static --condition none              score a method on embedded synthetic data
  prbench build-dataset adt --root ADT --out tables/adt     turn licensed recordings into a table
  prbench run --method static --condition none --data tables/adt --out runs/static
  prbench leaderboard export runs/* --format md
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns:
        0 on success; the ``exit_code`` of a :class:`PrbenchError`; 2 for wrong arguments; 130 after Ctrl-C.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a console that lacks a character shows a substitute, not a traceback
            stream.reconfigure(errors="replace")
    with clean_output():
        return _execute(arguments)


def _execute(arguments: Sequence[str] | None) -> int:
    parser = _parser()
    chosen = parser.parse_args(arguments)
    if not hasattr(chosen, "execute"):
        parser.print_help()
        return 2
    try:
        return chosen.execute(chosen)
    except PrbenchError as error:
        print(f"prbench: {_cut(str(error))}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        kept = "; finished parts are kept, the same command resumes" if chosen.resumes else ""
        print(f"prbench: interrupted{kept}.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output went away, as `| head` does
        return 0


def _cut(message: str) -> str:
    """A message that lists more than anybody reads, such as a header of 100,000 characters, without its middle."""
    if len(message) <= LONGEST_MESSAGE:
        return message
    half = LONGEST_MESSAGE // 2
    return f"{message[:half]} … ({len(message) - 2 * half} characters) … {message[-half:]}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="prbench",
        description="Prime-and-reach motion benchmark: curate sequences, run motion generators, score them.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"prbench {prbench.__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for command in _COMMANDS:
        command.add_parser(commands)
    return parser
