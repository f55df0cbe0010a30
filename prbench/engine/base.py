"""What every engine has in common: its promise, what became of an item, and lack of memory."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

from prbench.errors import MemoryFullError, PrbenchError
from prbench.shown import quoted

Item = TypeVar("Item")
Result = TypeVar("Result")
IfFull = Callable[[Item, PrbenchError], Result] | None
"""Gives the result of an item for which the memory does not suffice."""
KILLED = "a worker process ended without an answer: it was killed, or ran out of memory"


@dataclass(frozen=True)
class Full:
    """Stands in place of a result: the memory did not suffice, or the worker was killed."""

    reason: str
    error: PrbenchError | None = None
    """An error whose message already says it."""


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
    return isinstance(error, RuntimeError) and "can't allocate memory" in str(error)


def answer(function: Callable[[Item], Result], item: Item) -> Result | Full:
    """The result, or that the memory did not suffice, also where a message already says so."""
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
    """The result of the second try, or what stands for it."""
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
