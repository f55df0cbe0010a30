"""What runs in a worker process, and what comes back when its memory does not suffice."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from prbench.errors import PrbenchError
from prbench.shown import quoted

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Full:
    """In place of a result: the memory did not suffice, or the worker was killed."""

    reason: str
    told: PrbenchError | None = None
    """What says it better than we could."""


def is_out_of_memory(error: BaseException | None) -> bool:
    """Of Python, NumPy or Arrow, or of torch on either kind of device (recognised without importing it).

    One of our own errors is, if such a one has caused it.
    """
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
        return True
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    if isinstance(error, PrbenchError):
        return is_out_of_memory(error.__cause__)
    return isinstance(error, RuntimeError) and "can't allocate memory" in str(error)


def answer(function: Callable[[Item], Result], item: Item) -> Result | Full:
    """The result, or that the memory did not suffice, also where a message already says so."""
    try:
        return function(item)
    except Exception as error:
        if is_out_of_memory(error):
            told = error if isinstance(error, PrbenchError) else None
            return Full(f"the memory of this machine does not suffice ({quoted(error) or type(error).__name__})", told)
        raise


class _CtrlC:
    """What Ctrl-C does in a worker: it ends the item under way, and all that follow at once, without a traceback."""

    def __init__(self) -> None:
        self.working = self.pressed = False

    def __call__(self, *_: object) -> None:
        """Of the signal's handler."""
        self.pressed = True
        if self.working:
            raise KeyboardInterrupt


_ctrl_c = _CtrlC()


def call(function: Callable[[Item], Result], item: Item) -> Result | Full:
    """:func:`answer` in a worker, where Ctrl-C ends the item under way."""
    if _ctrl_c.pressed:
        raise KeyboardInterrupt
    _ctrl_c.working = True
    try:
        return answer(function, item)
    finally:
        _ctrl_c.working = False


def start_worker(threads: int) -> None:
    """Set up a worker process, before the numerical libraries load."""
    signal.signal(signal.SIGINT, _ctrl_c)
    # Numerical libraries read these when they load, which in a spawned worker is after this.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = str(threads)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this worker when its parent was killed and cannot tell it to: it would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
