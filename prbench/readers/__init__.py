"""Readers: native files of a dataset → :class:`prbench.recording.Recording`, one recording at a time.

All that knows a dataset lies in its folder here, and its numbers in its manifest. Each folder has the same files:

====================  ==================================================================================================
``__init__.py``       the reader (:class:`Reader`): finds recordings, reads one, and says what else it can do
``format.py``         names of files, columns and joints, axes, and the data classes that hold what the files say
``files.py``          finds the files of each recording and reads them, checked, in the dataset's own units and axes;
                      the options
``to_recording.py``   readings → ``Recording``: metres, Y up, seconds, 22 joints; the only place where units change
others                what one dataset has besides: tables of segments, hand models, skeletons, pickles, annotations
``synthetic*.py``     the same files of synthetic people
====================  ==================================================================================================

``aria_mps`` and ``egoallo`` serve several datasets. ``files``, ``found`` and ``extents`` help any. The entry-point
group ``prbench.readers`` lists the readers, ours and those of other packages (docs/adding-a-dataset.md);
:func:`reader_for` finds one by its dataset's name.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar, runtime_checkable

import msgspec

from prbench.datasets import ENTRY_POINT_GROUP, SYNTHETIC_PREFIX, find_reader, origin_of
from prbench.errors import PrbenchError, UsageError, did_you_mean
from prbench.files.bounded import allowed_values, as_path, require
from prbench.files.storage import file_digest
from prbench.readers.extents import Extent, shortfalls
from prbench.readers.files import decode_json
from prbench.readers.found import InputFile, RecordingFiles, is_present
from prbench.recording import PublishedTrack, Recording, UnreadableEntry
from prbench.shown import quoted

if TYPE_CHECKING:
    from prbench.readers.egoallo.files import EgoalloInputs


class ReaderOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every reader's options; this one has none.

    Fields are ``bool``, ``int``, ``float``, ``str``, ``Literal`` or ``Path | None``, each with a default and a
    docstring. What a field changes must show in the recording, never only in a log.
    """

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of all options."""
        return tuple(field.name for field in msgspec.structs.fields(cls))


Options = TypeVar("Options", bound=ReaderOptions)


def parse_options(form: type[Options], given: Mapping[str, str], *, dataset: str) -> Options:
    """Return the options of a reader that texts stand for.

    Raises:
        UsageError: for a name that the reader does not know, or a value that is none of its kind.
    """
    for name in given:
        if name not in form.names():
            hint = did_you_mean(name, form.names())
            known = ", ".join(form.names()) or "none"
            raise UsageError(f"the reader of {dataset} has no option '{name}'.{hint} Its options are: {known}.")
    try:
        return msgspec.convert(dict(given), form, strict=False, dec_hook=as_path)
    except msgspec.ValidationError as error:
        problem = f"an option of the reader of {dataset} has a wrong value: {error}.{allowed_values(error, form)}"
        raise UsageError(problem) from error


def described_options(options: ReaderOptions) -> dict[str, str]:
    """Return options as text without places of this machine: of a file its digest, of a folder its name."""
    described = {}
    for name in options.names():
        value = getattr(options, name)
        text = "" if value is None else str(value)
        if isinstance(value, Path):
            value = value.expanduser()
            text = file_digest(value) if value.is_file() else value.name
        described[name] = text.lower() if isinstance(value, bool) else text
    return described


SYNTHETIC_FILE = "synthetic.json"
_SYNTHETIC_NAME = re.compile(r"_synthetic_seed\d+_|_invented_a\d+_")  # Stands in the name of every invented recording.


class SyntheticTree(msgspec.Struct, frozen=True, kw_only=True):
    """Origin and splits of a synthetic tree.

    Attributes:
        split: Split of each recording, by id.
    """

    generator: str
    version: int
    seed: int
    preset: str
    world: Literal["default", "large"]
    split: dict[str, Literal["train", "validation", "test"]]


def read_synthetic_tree(root: Path) -> SyntheticTree | None:
    """Read the mark of a synthetic tree: in ``root``, or beside it if ``root`` is one of its recordings.

    Returns:
        None for a folder of real recordings.

    Raises:
        InputFileError: if the mark is damaged.
    """
    for folder in (root, root.parent):
        if is_present(folder / SYNTHETIC_FILE):
            return decode_json(folder / SYNTHETIC_FILE, SyntheticTree)
    return None


def synthetic_tree_around(folder: Path, root: Path) -> SyntheticTree | None:
    """Return the mark that a recording's folder lies under: the nearest one on the way up to ``root``, or beside it.

    Roots may be given one level too high; what is invented has to keep its name and splits there, too.

    Raises:
        InputFileError: if the mark is damaged.
    """
    way = [place for place in (folder, *folder.parents) if place.is_relative_to(root)]
    return next((tree for tree in map(read_synthetic_tree, (*way, root)) if tree is not None), None)


def lacks_mark(recording_id: str, dataset: str) -> bool:
    """Return True for an invented recording that would pass as a real one, because its mark was not copied."""
    return _SYNTHETIC_NAME.search(recording_id) is not None and not dataset.startswith(SYNTHETIC_PREFIX)


def require_marked(root: Path, recordings: Mapping[str, str]) -> None:
    """Refuse invented recordings that were copied without their mark: they would pass as real ones.

    Args:
        root: The folder that was searched.
        recordings: Name of the dataset of each recording, by the recording's name.

    Raises:
        InputFileError: naming one of them.
    """
    for name, dataset in recordings.items():
        expected = f"{SYNTHETIC_FILE} beside recordings whose names say that they are invented"
        remedy = f"Copy {SYNTHETIC_FILE} of the tree that they come from, too."
        require(root, (not lacks_mark(name, dataset), "", expected, f"{name} without it", remedy))


def require_one_origin(root: Path, datasets: Iterable[str]) -> None:
    """Refuse a folder in which real and invented recordings lie together: one table may not mix them.

    Raises:
        InputFileError: if the names of the recordings' datasets differ.
    """
    names = sorted(set(datasets))
    expected = "recordings that are all real or all invented"
    remedy = f"Give a folder that holds one of them; {SYNTHETIC_FILE} marks what is invented."
    require(root, (len(names) <= 1, "", expected, f"{' and '.join(names)} together", remedy))


@runtime_checkable
class Reader(Protocol):
    """Reads one dataset; a frozen data class, so that options make a new one."""

    @property
    def dataset(self) -> str:
        """Name of the dataset."""
        ...

    @property
    def options(self) -> ReaderOptions:
        """Return the user's choices; the class of the default value tells which options there are."""
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
            OSError: if a file cannot be opened.
        """
        ...


@runtime_checkable
class NamesFurtherFiles(Reader, Protocol):
    """A reader some of whose files are required only because others are there, or name them."""

    def require_further(self, found: RecordingFiles) -> object:
        """Do that part of reading which asks for such files; `prbench inspect` does it, too.

        Raises:
            InputFileError: naming the file that is missing, and what asks for it.
        """


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


@runtime_checkable
class AnnotatedByHand(Reader, Protocol):
    """A reader of a dataset without events: it describes the table into which a person writes them."""

    @property
    def annotation_columns(self) -> tuple[str, ...]:
        """Return the columns of the table, those of a proposal included."""
        ...

    def annotation_line(self, found: RecordingFiles) -> AnnotationLine:
        """Return the line of one recording, still to be filled in.

        Raises:
            InputFileError: for files that cannot be made out.
        """
        ...


@runtime_checkable
class CountsAnnotations(Reader, Protocol):
    """A reader of a dataset whose annotations can be counted without its streams."""

    def annotation_counts(self, recordings: Sequence[RecordingFiles]) -> AnnotationCounts | None:
        """Count the annotations that lie beside recordings; None where there are none.

        Raises:
            InputFileError: if a file is no JSON.
        """


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


@dataclass(frozen=True)
class AnnotationLine:
    """One recording in a table of events that a person fills in.

    Attributes:
        cells: Cells that are known beforehand, by column.
        frame_rate: Frames a second of the column ``event_frame``.
        hint: Time at which the dataset hints at an event, seconds on the recording's clock.
    """

    recording_id: str
    cells: Mapping[str, object]
    frame_rate: float
    hint: float | None


@dataclass(frozen=True)
class AnnotationCounts:
    """How many annotations of its events a dataset's files hold.

    Attributes:
        totals: ``videos``, ``participants``, ``objects``, ``picks``, ``puts``, ``masks`` and ``primed`` of all videos.
        by_participant: The same of each participant.
        published: The same as others counted them, by who did.
        priming: Published priming, by action: ``primed``, ``not_primed`` and ``excluded``.
        unreadable: Entries that cannot be read.
        remarks: What a user should know about these numbers.
        examples: The first movement of each recording, in words.
    """

    totals: dict[str, int]
    by_participant: dict[str, dict[str, int]]
    published: dict[str, dict[str, int]]
    priming: dict[str, dict[str, int]]
    unreadable: tuple[UnreadableEntry, ...]
    remarks: tuple[str, ...]
    examples: tuple[str, ...]


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
    origin = origin_of(installed)
    try:
        reader = EntryPoint(installed.name, installed.target, ENTRY_POINT_GROUP).load()
    except (Exception, SystemExit) as error:
        cause = f"{type(error).__name__}: {error}".rstrip(".")
        raise UsageError(f"{origin}: cannot be imported: {cause}. Repair or reinstall the package.") from error
    if not isinstance(reader, Reader) or not dataclasses.is_dataclass(reader):
        said = f"{origin}: expected an instance of a frozen data class with dataset, options, find() and read(), found"
        raise UsageError(f"{said} {type(reader).__name__}.")
    if reader.dataset != installed.name:
        raise UsageError(f"{origin}: it reads '{quoted(reader.dataset)}'; both names must be the same.")
    if not options:
        return reader
    chosen = parse_options(type(reader.options), options, dataset=installed.name)
    return dataclasses.replace(reader, options=chosen)  # type: ignore[type-var]


def cut_short(found: RecordingFiles, recording: Recording | None = None) -> tuple[str, ...]:
    """Compare the ends of all streams of a recording with its span.

    Args:
        found: The recording's files; only their ends are looked at.
        recording: What reading it gave, where somebody has: it tells what the ends of files in archives do not.

    Returns:
        One message a stream that ends early or begins late. None of a recording whose files cannot be made out
        (reading it says why), or whose reader does not know the ends.
    """
    reader = reader_for(found.dataset)
    if not isinstance(reader, KnowsEnds):
        return ()
    try:
        return shortfalls(reader.extents(found, recording))
    except (PrbenchError, OSError):
        return ()
