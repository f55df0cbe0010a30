"""Recordings on disk with their input files and sizes: the result of a reader's cheap search."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from prbench.errors import InputFileError, RecordingUnusable

_SHOWN = 8  # Names that a message lists.


@dataclass(frozen=True)
class InputFile:
    """One file that reading a recording depends on.

    Attributes:
        role: Role of the file for the reader; unique within a recording.
        size: Bytes; of the member alone where it lies in an archive.
        member: Name inside the zip archive ``path``; empty for a plain file.
    """

    role: str
    path: Path
    size: int
    member: str = ""


class FilesOnDemand(Sequence[InputFile]):
    """The files of one recording, listed when somebody asks for them first.

    A recording of many thousand files takes long to list; most commands ask about a few of a dataset's recordings.

    Args:
        list_files: Lists them.
    """

    def __init__(self, list_files: Callable[[], Iterable[InputFile]]) -> None:
        self._list_files = list_files

    @cached_property
    def _files(self) -> tuple[InputFile, ...]:
        return tuple(self._list_files())

    def __getitem__(self, index: Any) -> Any:
        """Return one of the files, or some, in the order of the listing."""
        return self._files[index]

    def __len__(self) -> int:
        """Return the number of files."""
        return len(self._files)

    def __eq__(self, other: object) -> bool:
        """Return True where these are the same files in the same order."""
        return isinstance(other, Sequence) and self._files == tuple(other)

    def __reduce__(self) -> tuple[object, ...]:
        """Pass the list itself on to another process."""
        return tuple, (self._files,)


@dataclass(frozen=True)
class RecordingFiles:
    """One recording that was found, not yet read.

    Attributes:
        dataset: Name that the recording will carry: the reader's, or ``synthetic-`` before it.
        files: Every input that was found; a missing required one is reported by reading, not by searching.
        split: The dataset's official split, where its files tell it; None = by the split rule.
        skip_reason: Reason why a build must leave it out, reported as skipped and not as failed; None for all that are
            fine.
    """

    dataset: str
    recording_id: str
    folder: Path
    files: Sequence[InputFile]
    split: Literal["train", "validation", "test"] | None = None
    skip_reason: str | None = None

    def require_usable(self, reason: str | None) -> None:
        """Refuse the recording, if there is a reason to.

        Raises:
            RecordingUnusable: giving the reason.
        """
        if reason:
            raise RecordingUnusable(f"{self.recording_id} is skipped: {reason}.")

    def path(self, role: str) -> Path | None:
        """Return the file of one role, or None where it was not found."""
        return next((file.path for file in self.files if file.role == role), None)

    def require(self, role: str, name: str) -> Path:
        """Return the file of one role.

        Raises:
            InputFileError: if it was not found; ``name`` tells the user what was looked for.
        """
        path = self.path(role)
        if path is None:
            present = _first_names(sorted({file.path.name for file in self.files})) or "none of the expected files"
            found = f"no such file beside {present}"
            remedy = "Download the recording again."
            raise InputFileError(self.folder / name, "", expected="this file", found=found, remedy=remedy)
        return path


def existing_folder(root: Path | str, expected: str) -> Path:
    """Return the folder that a user gave to a search, in full.

    Raises:
        InputFileError: if there is none; ``expected`` tells the user what was looked for.
    """
    root = Path(root).expanduser().resolve()
    if not root.is_dir():
        raise InputFileError(root, "", expected=expected, found="no such folder")
    return root


def input_file(role: str, path: Path) -> InputFile:
    """Return an existing file with its size; 0 for a link that leads nowhere, which reading it reports."""
    try:
        return InputFile(role, path, path.stat().st_size)
    except OSError:  # a link that leads nowhere, found by its name
        return InputFile(role, path, 0)


def is_present(path: Path) -> bool:
    """Return True where something has this name: a file, or a folder or a broken link in its place.

    An optional file is absent only where nothing has its name. What stands there otherwise is listed, and reading it
    says that it cannot be read; a result that was made without it would pass for one that never had it.
    """
    return os.path.lexists(path)


def names_in(folder: Path) -> str:
    """List a folder for a message: the first names, and how many more there are."""
    return _first_names([path.name for path in sorted(folder.iterdir())]) or "an empty folder"


def _first_names(names: list[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
