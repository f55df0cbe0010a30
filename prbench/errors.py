"""The exceptions that a user can meet, each with what was expected, what was found and what to do.

Everything here derives from :class:`PrbenchError`; the command line prints such an error as one message
and exits with its ``exit_code``, without a traceback. Anything else that escapes is a defect of prbench.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from prbench.limits import LONGEST_MESSAGE, LONGEST_PATH
from prbench.shown import clean, condensed, quoted


class PrbenchError(Exception):
    """A problem that the user can repair.

    Args:
        message: What was expected and found, and what to do. Characters that steer a terminal are spelt out, and what
            a file made longer than anybody reads is cut.
    """

    exit_code = 1

    def __init__(self, message: str = "") -> None:
        message = condensed(message)
        if len(message) > LONGEST_MESSAGE:
            message = f"{message[:LONGEST_MESSAGE]} … ({len(message) - LONGEST_MESSAGE} more characters)"
        super().__init__(clean(message, keep="\n\t"))


class InputFileError(PrbenchError):
    """A file that prbench was asked to read does not hold what its format promises.

    Args:
        path: The file.
        where: Row, key or column inside it; empty if the file as a whole is meant.
        expected: What the format asks for.
        found: What stands there.
        remedy: What the user can do about it.
    """

    exit_code = 3

    def __init__(self, path: Path | str, where: str, *, expected: str, found: str, remedy: str = "") -> None:
        self.path, self.where, self.expected, self.found, self.remedy = Path(path), where, expected, found, remedy
        file = quoted(path, longest=LONGEST_PATH)
        place = f"{file}, {quoted(where)}" if where else file
        super().__init__(f"{place}: expected {expected}, found {quoted(found)}.{' ' + remedy if remedy else ''}")

    def __reduce__(self) -> tuple[object, ...]:
        """Keep the keyword-only parts when the error crosses a process border."""
        rebuild = partial(type(self), expected=self.expected, found=self.found, remedy=self.remedy)
        return rebuild, (self.path, self.where)


class ErrorOfParts(PrbenchError):
    """An error that makes its message of its parameters, and keeps them as attributes in their order."""

    def __reduce__(self) -> tuple[object, ...]:
        """Keep the parts when the error crosses a process border: pickle would hand over the finished message."""
        return type(self), tuple(vars(self).values())


class UnforeseenInput(InputFileError):
    """A file made prbench stumble in a way that no check foresaw (see :mod:`prbench.files.bounded`).

    For a user it is one more damaged file. For prbench it is a missing check: a test that damages files fails on it.
    """


class RecordingUnusable(PrbenchError):
    """A recording is known or found to be unfit; a build reports it and goes on with the others."""

    exit_code = 3


class StreamsDoNotOverlap(PrbenchError):
    """Streams of one recording share no instant; the message names both ranges and the likely unit."""

    exit_code = 3


class TableError(PrbenchError):
    """A sequence table is missing, empty, of an unknown version, or inconsistent in itself."""

    exit_code = 4


class AdapterError(PrbenchError):
    """A method is unknown, cannot be loaded, or broke the adapter contract."""

    exit_code = 5


class PredictionsError(PrbenchError):
    """A predictions file does not match the table that it is scored on."""

    exit_code = 6


class RunError(PrbenchError):
    """A run folder belongs to other inputs than the ones given, or is damaged."""

    exit_code = 7


class ShardError(PrbenchError):
    """Shards are missing, overlap, are of different builds or runs, or one of them is unfinished or damaged."""

    exit_code = 14


class StorageError(PrbenchError):
    """Writing failed: the disk is full, the folder is not writable, or a file is in the way."""

    exit_code = 8


class RecordingsWouldBeLost(StorageError):
    """A built table would be replaced by one that holds less, and the user has not asked for that."""


class MemoryFullError(ErrorOfParts):
    """The machine's memory does not suffice for one item of the work, also when nothing else is done beside it.

    Args:
        item: Recording, batch or other item.
        reason: What happened.
    """

    exit_code = 12

    def __init__(self, item: str, reason: str) -> None:
        self.item, self.reason = item, reason
        super().__init__(
            f"{clean(item)}: {clean(reason)}. Nothing half-written was kept, and what is finished stays: end other"
            " programs, do less at once (--batch-size, --limit, --workers), or use a machine with more memory."
        )


class UsageError(PrbenchError):
    """The command line asks for something that does not exist or does not fit together."""

    exit_code = 2


class RedistributionError(PrbenchError):
    """A dataset's licence does not let its recordings be written into something that is meant to be passed on."""

    exit_code = 10


class TrainingError(PrbenchError):
    """A training folder belongs to another training, or the training cannot go on."""

    exit_code = 11


class TrainingStopped(PrbenchError):
    """A training was asked to stop and has saved what it had; the same command goes on.

    Args:
        message: What was saved.
        signal: Number of the signal that asked; the exit code is 128 more, as shells have it. By default SIGTERM's.
    """

    def __init__(self, message: str, *, signal: int | None = None) -> None:
        self.signal = signal or 15
        self.exit_code = 128 + self.signal
        super().__init__(message)


class ClusterError(PrbenchError):
    """A cluster cannot be reached, one of its nodes is unfit for the work, or none is left."""

    exit_code = 13


class WorkStopped(PrbenchError):
    """Work was asked to stop by SIGTERM; its workers were ended, and the same command goes on where it resumes."""

    exit_code = 143


class MissingExtraError(ErrorOfParts):
    """An optional package is needed; the message holds the ``pip install`` line that helps."""

    exit_code = 9

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package, self.extra, self.purpose = package, extra, purpose
        super().__init__(
            f"{purpose} needs the package '{package}', which is not installed. Run: pip install 'prbench[{extra}]'"
        )


class UnloadableExtraError(ErrorOfParts):
    """An optional package is installed and cannot be loaded, for example because a library of the system is missing.

    Args:
        package: Name of the package.
        purpose: What needs it.
        reason: What the system said.
        remedy: What the user can do about it.
    """

    exit_code = 9

    def __init__(self, package: str, purpose: str, reason: str, remedy: str) -> None:
        self.package, self.purpose, self.reason, self.remedy = package, purpose, reason, remedy
        super().__init__(
            f"{purpose} needs the package '{package}', which is installed and cannot be loaded: {reason}. {remedy}"
        )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a question for the end of a message that refuses a name, with a leading space; empty if no name is near.

    >>> did_you_mean("sttic", ["pr", "static"])
    " Did you mean 'static'?"
    """
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.55)
    return f" Did you mean '{near[0]}'?" if near else ""
