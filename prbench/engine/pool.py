"""What every engine has in common, work in this process and in a pool of processes, and memory that is given back."""

from __future__ import annotations

import ctypes
import errno
import gc
import itertools
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from prbench.engine.unseen import hide_process, is_hidden, start_bare_tracker
from prbench.errors import MemoryFullError, PrbenchError
from prbench.shown import quoted

Item = TypeVar("Item")
Result = TypeVar("Result")
# Gives the result of an item for which the memory does not suffice.
IfFull = Callable[[Item, PrbenchError], Result] | None
# What torch, threads and the loader of libraries say where memory is short.
_LACKS_MEMORY = ("can't allocate memory", "can't start new thread", "failed to map segment")
KILLED = "a worker process ended without an answer: it was killed, or ran out of memory"


@dataclass(frozen=True)
class Full:
    """Stands in place of a result: the memory did not suffice, or the worker was killed.

    Attributes:
        error: An error whose message already says it.
    """

    reason: str
    error: PrbenchError | None = None


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return True if Python, NumPy, Arrow or torch lacked memory; torch is recognised without importing it.

    One of our own errors is, if such a one has caused it.
    """
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
        return True
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    if isinstance(error, PrbenchError):
        return is_out_of_memory(error.__cause__)
    return isinstance(error, RuntimeError | ImportError) and any(words in str(error) for words in _LACKS_MEMORY)


def answer(function: Callable[[Item], Result], item: Item) -> Result | Full:
    """Return the result, or that the memory did not suffice, also where a message already says so."""
    try:
        return function(item)
    except Exception as error:
        if is_out_of_memory(error):
            ours = error if isinstance(error, PrbenchError) else None
            return Full(f"the memory of this machine does not suffice ({quoted(error) or type(error).__name__})", ours)
        raise


@runtime_checkable
class Engine(Protocol):
    """Something that runs work."""

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], *, if_full: IfFull[Item, Result] = None
    ) -> Iterator[Result]:
        """Yield ``function(item)`` for every item, in the order of the items.

        ``function`` and the items must be picklable; the first exception is raised where its result would stand. An
        item for which the memory did not suffice is tried once more, alone.

        Args:
            function: What is done with an item.
            items: Taken up as they are needed.
            if_full: Gives the result of an item for which the memory does not suffice alone either, from the item and
                the error; called in this process. By default the error is raised.
        """
        ...


def settled(found: Result | Full, item: Item, if_full: IfFull[Item, Result]) -> Result:
    """Return the result of the second try, or what stands for it."""
    if not isinstance(found, Full):
        return found
    error = found.error or MemoryFullError(item_name(item), found.reason)
    if if_full is None:
        raise error
    return if_full(item, error)


def item_name(item: object) -> str:
    """Return the name of an item for a message."""
    for attribute in ("recording_id", "name"):
        name = getattr(item, attribute, None)
        if isinstance(name, str):
            return name
    return "one item of the work"


_ctrl_c = {"working": False, "pressed": False}


def _on_ctrl_c(*_: object) -> None:
    """Handle Ctrl-C in a worker: end the item under way, and all that follow at once, without a traceback."""
    _ctrl_c["pressed"] = True
    if _ctrl_c["working"]:
        raise KeyboardInterrupt


def call(function: Callable[[Item], Result], item: Item) -> Result | Full:
    """:func:`answer` in a worker, where Ctrl-C ends the item under way."""
    if _ctrl_c["pressed"]:
        raise KeyboardInterrupt
    _ctrl_c["working"] = True
    try:
        return answer(function, item)
    finally:
        _ctrl_c["working"] = False


def _start_worker(threads: int, hidden: bool) -> None:
    """Set up a worker process, before the numerical libraries load; of a hidden process it is hidden, too."""
    if hidden:
        hide_process()
    signal.signal(signal.SIGINT, _on_ctrl_c)
    # Numerical libraries read these when they load, which in a spawned worker is after this.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = str(threads)
    end_with_parent()


def end_with_parent() -> None:
    """End this child as soon as its parent was killed and cannot tell it to: it would wait, or work, for ever."""

    def wait() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@dataclass(frozen=True)
class InProcess:
    """One item after the other, in this process."""

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], *, if_full: IfFull[Item, Result] = None
    ) -> Iterator[Result]:
        """See :class:`Engine`.

        Raises:
            MemoryFullError: if the memory does not suffice for an item.
        """
        for item in items:
            found = answer(function, item)
            if isinstance(found, Full):
                gc.collect()
                found = settled(answer(function, item), item, if_full)
            yield found


@dataclass(frozen=True)
class ProcessPool:
    """A pool of spawned processes. At most ``2 * workers`` items are under way, so memory stays flat."""

    workers: int
    threads_per_worker: int = 1

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], *, if_full: IfFull[Item, Result] = None
    ) -> Iterator[Result]:
        """See :class:`Engine`.

        Raises:
            MemoryFullError: if the memory does not suffice for an item, or a worker process dies with it (killed, by
                the operating system for its memory, too), also when it is worked on alone.
        """
        waiting = iter(items)
        under_way: deque[_Submitted[Item]] = deque()
        pool: ProcessPoolExecutor | None = None
        try:
            while True:
                free = 2 * self.workers - len(under_way)
                under_way.extend(_Submitted(item) for item in itertools.islice(waiting, free))
                if not under_way:
                    return
                first = under_way[0]
                if not first.suspected:
                    pool = pool or self._pool(self.workers)
                    for each in under_way:
                        each.submit(pool, function)
                    found = first.answer()
                    if not isinstance(found, Full):
                        under_way.popleft()
                        yield found
                        continue
                if pool is not None:
                    pool.shutdown()  # the others come to their end first
                    pool = None
                    for each in under_way:
                        each.suspect_if_full()
                under_way.popleft()
                yield settled(self._alone(function, first.item), first.item, if_full)
        finally:
            if pool is not None:
                # By the pool itself: a future that is cancelled from here while Ctrl-C ends idle workers, too, makes
                # its thread print a traceback.
                pool.shutdown(cancel_futures=True)

    def _alone(self, function: Callable[[Item], Result], item: Item) -> Result | Full:
        with self._pool(1) as pool:
            again = _Submitted(item)
            again.submit(pool, function)
            return again.answer()

    def _pool(self, workers: int) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        hidden = is_hidden()
        if hidden:
            start_bare_tracker()
        return ProcessPoolExecutor(
            workers, mp_context=context, initializer=_start_worker, initargs=(self.threads_per_worker, hidden)
        )


@dataclass
class _Submitted(Generic[Item]):
    """An item that is under way.

    Attributes:
        suspected: The memory did not suffice, or a worker was killed while this item was under way; it is worked on
            alone.
    """

    item: Item
    future: Future | None = None
    suspected: bool = False

    def submit(self, pool: ProcessPoolExecutor, function: Callable[[Item], object]) -> None:
        """Give it to the pool, unless it was given to one before or must be alone."""
        if self.future is not None or self.suspected:
            return
        try:
            self.future = pool.submit(call, function, self.item)
        except BrokenProcessPool as error:
            self.future = Future()
            self.future.set_exception(error)

    def answer(self) -> Any:
        """Return the result, or that there is none for lack of memory."""
        assert self.future is not None
        try:
            return self.future.result()
        except BrokenProcessPool:
            return Full(KILLED)

    def suspect_if_full(self) -> None:
        """Note that it has no result for lack of memory, after the pool has come to its end."""
        assert self.future is not None
        killed = isinstance(self.future.exception(), BrokenProcessPool)
        self.suspected = killed or (self.future.exception() is None and isinstance(self.future.result(), Full))


def give_back() -> None:
    """Return what allocators keep of freed memory; call it between two stages that each take much of their own.

    Arrow's pool and the C library keep freed memory for later, in pieces that the next stage seldom fits into.
    """
    import pyarrow as pa  # most work of an engine, and its start, goes without

    pa.default_memory_pool().release_unused()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
        if trim is not None:
            trim(0)
