"""``prbench``: find the command, run it, and turn a user's error into one message and an exit code."""

from __future__ import annotations

import argparse
import io
import multiprocessing
import signal
import sys
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

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
from prbench.engine import end_with_parent
from prbench.errors import AdapterError, PrbenchError
from prbench.methods.remote.faults import exit_story

_Command = Callable[[Sequence[str]], int]
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


def calls_foreign_code(chosen: argparse.Namespace) -> bool:
    """Return True for a command that calls an installed method of another package in this process."""
    if not getattr(chosen, "runs_a_method", False) or chosen.isolate:
        return False
    from prbench.methods.installed import list_adapters

    claims = (adapter for adapter in list_adapters() if adapter.name == chosen.method)
    return any(not adapter.built_in and not adapter.problem for adapter in claims)


def supervised(command: _Command, arguments: Sequence[str], *, method: str) -> int:
    """Run a command in a child process and return its exit code.

    Args:
        command: Importable; called in the child with the arguments.
        arguments: Of the command line.
        method: Whose code runs there, for the message.

    Raises:
        AdapterError: if the child ends without having returned from the command.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_report, args=(command, list(arguments), sender))
    child.start()
    previous = _answered_by(child)
    child.join()  # not the end of the pipe: what the method has started may hold that open
    for number, handler in previous.items():
        signal.signal(number, handler)
    if receiver.poll():
        return int(receiver.recv_bytes())
    status = child.exitcode or 0
    if -status in (signal.SIGINT, signal.SIGTERM):
        return 128 - status
    raise AdapterError(
        f"method '{method}': the process that it ran in {exit_story(status)}, so there are no scores. A method must"
        " not call os._exit() or leave the process from C; it raises an exception instead. Finished batches are kept;"
        " --isolate runs it in a process of its own and shows what it wrote last."
    )


def _report(command: _Command, arguments: list[str], sender: Connection) -> None:
    """Run the command in the child, and say how it ended."""
    end_with_parent()
    code = 1  # of a traceback
    try:
        code = command(arguments)
    finally:
        sender.send_bytes(str(code).encode())


def _answered_by(child: BaseProcess) -> dict[int, Any]:
    """Leave Ctrl-C and requests to stop to the child; returns the handlers until now."""

    def pass_on(number: int, _: FrameType | None) -> None:
        if number == signal.SIGTERM:  # Ctrl-C reaches the child without us
            child.terminate()

    return {number: signal.signal(number, pass_on) for number in (signal.SIGINT, signal.SIGTERM)}
