"""Readers: native files of a dataset → :class:`prbench.recording.Recording`, one recording at a time.

A new dataset is a new module with a ``READER`` and one line in :data:`READER_MODULES`.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

from prbench.errors import UsageError, did_you_mean
from prbench.readers.found import InputFile, RecordingFiles
from prbench.readers.options import ReaderOptions, described_options, parse_options
from prbench.readers.synthetic_tree import (
    SYNTHETIC_PREFIX,
    SyntheticTree,
    read_synthetic_tree,
    require_one_origin,
    synthetic_tree_around,
)
from prbench.recording import Recording

__all__ = [
    "READER_MODULES",
    "InputFile",
    "Reader",
    "ReaderOptions",
    "RecordingFiles",
    "SyntheticTree",
    "described_options",
    "read_synthetic_tree",
    "reader_for",
    "require_one_origin",
    "synthetic_tree_around",
]

READER_MODULES: dict[str, str] = {
    "adt": "prbench.readers.adt",
    "gimo": "prbench.readers.gimo",
    "hd-epic": "prbench.readers.hd_epic",
    "hot3d": "prbench.readers.hot3d",
    "mogaze": "prbench.readers.mogaze",
}
"""Module of each dataset's reader; imported when it is asked for."""


@runtime_checkable
class Reader(Protocol):
    """Reads one dataset; a frozen data class, so that options make a new one."""

    @property
    def dataset(self) -> str:
        """Name of the dataset."""
        ...

    @property
    def options(self) -> ReaderOptions:
        """What the user chose; the class of the default value tells which options there are."""
        ...

    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
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


def reader_for(dataset: str, options: Mapping[str, str] | None = None) -> Reader:
    """The reader of a dataset; ``synthetic-`` before the name is ignored, since both have the same layout.

    Args:
        dataset: Name of the dataset.
        options: Options of its reader as text; the defaults where a name is missing.

    Raises:
        UsageError: for a dataset without reader, with the nearest known name, and for an unknown option or value.
    """
    name = dataset.removeprefix(SYNTHETIC_PREFIX)
    if name not in READER_MODULES:
        hint = did_you_mean(name, READER_MODULES)
        raise UsageError(f"no reader for '{dataset}'.{hint} There are readers for: {', '.join(READER_MODULES)}.")
    reader: Reader = importlib.import_module(READER_MODULES[name]).READER
    if not options:
        return reader
    return dataclasses.replace(reader, options=parse_options(type(reader.options), options, dataset=name))  # type: ignore[type-var]
