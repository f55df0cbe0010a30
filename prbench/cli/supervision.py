"""A method of another package in a child process: it may leave that process, and the shell is still told the truth."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from prbench.engine import end_with_parent
from prbench.entry_points import ADAPTERS
from prbench.errors import AdapterError
from prbench.harness.methods.remote.faults import exit_story

_Command = Callable[[Sequence[str]], int]


def calls_foreign_code(method: str, *, isolate: bool, entry_points: str = ADAPTERS) -> bool:
    """Return True where an installed method of another package would be called in this process."""
    if isolate:
        return False
    from prbench.harness.methods.installed import list_adapters

    claims = (adapter for adapter in list_adapters(entry_points) if adapter.name == method)
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
