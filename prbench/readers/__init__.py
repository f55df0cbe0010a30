"""Readers: native files of a dataset → :class:`prbench.recording.Recording`, one recording at a time.

A new dataset is a new module with a ``READER`` and one line in :data:`READER_MODULES`.
"""

from __future__ import annotations

import importlib
from difflib import get_close_matches
from pathlib import Path
from typing import Protocol, runtime_checkable

from prbench.errors import UsageError
from prbench.readers.found import InputFile, RecordingFiles
from prbench.readers.synthetic_tree import SYNTHETIC_PREFIX, SyntheticTree, read_synthetic_tree
from prbench.recording import Recording

__all__ = [
    "READER_MODULES",
    "InputFile",
    "Reader",
    "RecordingFiles",
    "SyntheticTree",
    "read_synthetic_tree",
    "reader_for",
]

READER_MODULES: dict[str, str] = {"adt": "prbench.readers.adt"}
"""Module of each dataset's reader; imported when it is asked for."""


@runtime_checkable
class Reader(Protocol):
    """Reads one dataset."""

    dataset: str

    def find(self, root: Path) -> tuple[RecordingFiles, ...]:
        """List the recordings below ``root`` (the dataset's folder, or one recording) without reading them.

        Raises:
            InputFileError: if there are none, saying what was looked for and what was found.
        """
        ...

    def read(self, found: RecordingFiles) -> Recording:
        """Read one recording.

        Raises:
            InputFileError: for a missing or damaged file.
            RecordingUnusable: for a recording that is known to be bad.
            StreamsDoNotOverlap: if its streams share no instant.
        """
        ...


def reader_for(dataset: str) -> Reader:
    """The reader of a dataset; ``synthetic-`` before the name is ignored, since both have the same layout.

    Raises:
        UsageError: for a dataset without reader, with the nearest known name.
    """
    name = dataset.removeprefix(SYNTHETIC_PREFIX)
    if name not in READER_MODULES:
        near = get_close_matches(name, READER_MODULES, n=1)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        raise UsageError(f"no reader for '{dataset}'.{hint} There are readers for: {', '.join(READER_MODULES)}.")
    return importlib.import_module(READER_MODULES[name]).READER
