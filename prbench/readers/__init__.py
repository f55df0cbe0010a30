"""Readers: native files of a dataset → :class:`prbench.recording.Recording`, one recording at a time.

All that knows a dataset lies in its folder here, and its numbers in its manifest. Each folder has the same files:

=====================  =================================================================================================
``__init__.py``        the reader (:class:`Reader`): finds recordings, reads one, and says what else it can do
``format.py``          names of files, columns and joints, axes, and the data classes that hold what the files say
``layouts.py``         where the files of each recording lie (also ``layout``, ``places``, ``segments``); the options
``readings.py``        files → readings, checked, in the dataset's own units and axes
``to_recording.py``    readings → ``Recording``: metres, Y up, seconds, 22 joints; the only place where units change
others                 what one dataset has besides: annotated events, hand models, skeletons
=====================  =================================================================================================

``aria_mps`` and ``egoallo`` serve several datasets. ``files``, ``pose_table``, ``found``, ``zipped`` and ``extents``
help any. The entry-point group ``prbench.readers`` lists the readers, ours and those of other packages
(docs/adding-a-dataset.md); :func:`reader_for` finds one by its dataset's name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from prbench.datasets import ENTRY_POINT_GROUP, SYNTHETIC_PREFIX, find_reader, origin_of
from prbench.entry_points import InstalledEntry
from prbench.errors import UsageError
from prbench.readers.found import InputFile, RecordingFiles
from prbench.readers.options import ReaderOptions, described_options, parse_options
from prbench.readers.synthetic_tree import (
    SyntheticTree,
    read_synthetic_tree,
    require_one_origin,
    synthetic_tree_around,
)
from prbench.recording import Recording
from prbench.recording.published_tracks import PublishedTrack
from prbench.shown import quoted

if TYPE_CHECKING:
    from prbench.readers.egoallo.inputs import EgoalloInputs
    from prbench.readers.extents import Extent
    from prbench.readers.zipped import Source

__all__ = [
    "SYNTHETIC_PREFIX",
    "AnnotatedByHand",
    "AnnotationLine",
    "AriaGlasses",
    "InputFile",
    "KnowsEnds",
    "PublishedForPrediction",
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


@runtime_checkable
class Reader(Protocol):
    """Reads one dataset; a frozen data class, so that options make a new one."""

    @property
    def dataset(self) -> str:
        """Name of the dataset."""
        ...

    @property
    def options(self) -> ReaderOptions:
        """The user's choices; the class of the default value tells which options there are."""
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


@runtime_checkable
class KnowsEnds(Reader, Protocol):
    """A reader that can say from when to when the streams of a recording reach."""

    def extents(self, found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:
        """Look at the ends of a recording's files, without reading them whole.

        Args:
            found: The recording's files.
            recording: What reading it gave, where somebody has.

        Raises:
            PrbenchError: for files that cannot be made out.
            OSError: likewise.
        """
        ...


@runtime_checkable
class AriaGlasses(Reader, Protocol):
    """A reader of recordings with Project Aria's glasses: it finds EgoAllo's inputs and the scene's point cloud.

    Such a reader has an option ``poses`` that takes ``egoallo``.
    """

    def egoallo_inputs(self, root: Path, found: RecordingFiles) -> EgoalloInputs:
        """Look for the files of one recording from which EgoAllo estimates its body.

        Raises:
            InputFileError: if it has no trajectory, or an archive is damaged.
        """
        ...

    def point_cloud(self, found: RecordingFiles) -> Source | None:
        """The semi-dense point cloud of one recording, in the frame of its trajectory; None where there is none."""
        ...


@runtime_checkable
class AnnotatedByHand(Reader, Protocol):
    """A reader of a dataset without events: it describes the table into which a person writes them."""

    @property
    def annotation_columns(self) -> tuple[str, ...]:
        """Columns of the table, those of a proposal included."""
        ...

    def annotation_line(self, found: RecordingFiles) -> AnnotationLine:
        """The line of one recording, still to be filled in.

        Raises:
            InputFileError: for files that cannot be made out.
        """
        ...


@runtime_checkable
class PublishedForPrediction(Reader, Protocol):
    """A reader of a dataset on which a study of motion prediction was made, with that study's pieces of it."""

    @property
    def native_joints(self) -> str:
        """Name of the study's joint set (docs/specification/motion-prediction.md#joint-sets)."""
        ...

    def read_published(self, found: RecordingFiles, *, native: bool) -> tuple[Recording, tuple[PublishedTrack, ...]]:
        """Read one recording with the pieces of it that the study used, at 30 frames a second.

        Args:
            found: The recording's files.
            native: Whether the pieces have the study's joints, or the 22 of every dataset.

        Raises:
            PrbenchError: as :meth:`Reader.read`.
        """
        ...

    def published_lengths(self, root: Path) -> Mapping[str, tuple[int, ...]] | None:
        """Frames of the study's pieces by published split, where one file tells them without any recording.

        Raises:
            InputFileError: if that file is missing or damaged.
        """
        ...


@dataclass(frozen=True)
class AnnotationLine:
    """One recording in a table of events that a person fills in."""

    recording_id: str
    cells: Mapping[str, object]
    """Cells that are known beforehand, by column."""
    frame_rate: float
    """Frames a second of the column ``event_frame``."""
    hint: float | None
    """Time at which the dataset hints at an event, seconds on the recording's clock."""


def reader_for(dataset: str, options: Mapping[str, str] | None = None) -> Reader:
    """Import the reader of a dataset; ``synthetic-`` before the name is ignored, since both have the same layout.

    Args:
        dataset: Name of the dataset.
        options: Options of its reader as text; the defaults where a name is missing.

    Raises:
        UsageError: for a dataset without reader, with the nearest known name, for a package whose reader cannot be
            imported or is none, and for an unknown option or value.
    """
    installed = find_reader(dataset)
    reader = _imported(installed)
    if not options:
        return reader
    chosen = parse_options(type(reader.options), options, dataset=installed.name)
    return dataclasses.replace(reader, options=chosen)  # type: ignore[type-var]


def _imported(installed: InstalledEntry) -> Reader:
    try:
        reader = EntryPoint(installed.name, installed.target, ENTRY_POINT_GROUP).load()
    except (Exception, SystemExit) as error:
        cause = f"{type(error).__name__}: {error}".rstrip(".")
        raise UsageError(
            f"{origin_of(installed)}: cannot be imported: {cause}. Repair or reinstall the package."
        ) from error
    if not isinstance(reader, Reader) or not dataclasses.is_dataclass(reader):
        raise UsageError(
            f"{origin_of(installed)}: expected an instance of a frozen data class with dataset, options, find() and"
            f" read(), found {type(reader).__name__}."
        )
    if reader.dataset != installed.name:
        raise UsageError(f"{origin_of(installed)}: it reads '{quoted(reader.dataset)}'; both names must be the same.")
    return reader
