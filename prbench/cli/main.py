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
from prbench.cli.supervised import calls_foreign_code, supervised
from prbench.cli.terminal import clean_output
from prbench.errors import PrbenchError

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
        if arguments is None and calls_foreign_code(chosen):  # from a shell, whose user sees nothing but the exit code
            return supervised(main, sys.argv[1:], method=chosen.method)
        return chosen.execute(chosen)
    except PrbenchError as error:
        print(f"prbench: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        kept = "; finished parts are kept, the same command resumes" if chosen.resumes else ""
        print(f"prbench: interrupted{kept}.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output went away, as `| head` does
        return 0


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
