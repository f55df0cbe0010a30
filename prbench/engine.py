"""Map a function over work items: in process or in a pool of spawned processes, in order, with the same results.

An engine is anything with :meth:`Engine.map`; builds, runs and scoring take one as an argument, so that another way to
spread work (a cluster, say) is one more class and no change elsewhere.
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

from prbench.errors import PrbenchError

Item = TypeVar("Item")
Result = TypeVar("Result")


@runtime_checkable
class Engine(Protocol):
    """Where work runs."""

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield ``function(item)`` for every item, in the order of the items.

        ``function`` and the items must be picklable; the first exception is raised where its result would stand.
        """
        ...


@dataclass(frozen=True)
class InProcess:
    """One item after the other, in this process."""

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """See :class:`Engine`."""
        return map(function, items)


@dataclass(frozen=True)
class ProcessPool:
    """A pool of spawned processes. At most ``2 * workers`` items are under way, so memory stays flat."""

    workers: int
    threads_per_worker: int = 1

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """See :class:`Engine`.

        Raises:
            PrbenchError: if a worker process dies (killed, or out of memory).
        """
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(
            self.workers, mp_context=context, initializer=_start_worker, initargs=(self.threads_per_worker,)
        ) as pool:
            waiting = iter(items)
            running: list[Future[Result]] = [
                pool.submit(_call, function, item) for item in itertools.islice(waiting, 2 * self.workers)
            ]
            try:
                while running:
                    result = running.pop(0).result()
                    running.extend(pool.submit(_call, function, item) for item in itertools.islice(waiting, 1))
                    yield result
            except BrokenProcessPool as error:
                raise PrbenchError(
                    "a worker process ended without an answer: it was killed or ran out of memory."
                    " Finished parts are kept; run the same command again with fewer --workers."
                ) from error
            finally:
                # By the pool itself: a future that is cancelled from here while Ctrl-C ends idle workers, too, makes
                # its thread print a traceback.
                pool.shutdown(cancel_futures=True)


def engine_for(workers: int) -> Engine:
    """``InProcess`` for one worker or none, else a ``ProcessPool``."""
    return InProcess() if workers <= 1 else ProcessPool(workers)


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


def _call(function: Callable[[Item], Result], item: Item) -> Result:
    """In a worker."""
    if _ctrl_c.pressed:
        raise KeyboardInterrupt
    _ctrl_c.working = True
    try:
        return function(item)
    finally:
        _ctrl_c.working = False


def _start_worker(threads: int) -> None:
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
