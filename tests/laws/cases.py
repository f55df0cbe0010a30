"""What the three laws are tried on: results that keep their bytes, input that is refused, commands that are killed.

A module ``tests/laws/<area>_cases.py`` lists cases in ``SAME_BYTES`` and ``BAD_INPUT``; nothing else registers them.
What is killed and resumed are the rows of ``tests/laws/killed_cases.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from prbench.errors import InputFileError


@dataclass(frozen=True)
class SameBytes:
    """A result that must not depend on how it was made."""

    name: str  # what is made, as in "ADT's table"
    ways: Mapping[str, Callable[[Path], object]]  # the first is the reference; writes into the folder, or returns it
    unequal: tuple[str, ...] = ()  # endings of names of files that hold times
    differs: Mapping[str, Callable[[Path], object]] | None = None  # ways that must change the result: another seed


@dataclass(frozen=True)
class BadInput:
    """Input that must be refused with a message that tells where, what was expected and found, and what to do."""

    name: str  # what is wrong, as in "gaze.csv: a time that goes back"
    act: Callable[[Path], object]  # makes the input in an empty folder and reads it
    told: tuple[str, ...]  # parts of the message
    error: type[Exception] = InputFileError
    unwritten: tuple[str, ...] = ()  # paths in the folder that must not exist afterwards


def bad_files(
    of: str,
    make: Callable[[Path], Path],
    read: Callable[[Path], object],
    damages: Mapping[str, tuple[Callable[[Path], object], Sequence[str]]],
    *,
    error: type[Exception] = InputFileError,
) -> list[BadInput]:
    """Return a case for each damage to a file or tree that is read without an error when nothing is damaged.

    Args:
        of: What is read, for the names of the cases.
        make: Writes good input into an empty folder and returns the path that is read.
        read: Reads that path.
        damages: From the name of a damage to a function that changes what stands at the path, and parts of the message.
        error: Class of the error.
    """

    def case(damage: Callable[[Path], object]) -> Callable[[Path], object]:
        def act(folder: Path) -> object:
            path = make(folder)
            read(path)  # or the test would pass for input that was never good
            damage(path)
            return read(path)

        return act

    return [BadInput(f"{of}: {name}", case(damage), tuple(told), error) for name, (damage, told) in damages.items()]
