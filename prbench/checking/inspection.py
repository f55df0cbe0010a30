"""``prbench inspect``: what a folder holds, and which of its recordings are complete, before hours are spent."""

from __future__ import annotations

import contextlib
import fnmatch
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from prbench import readers
from prbench.curation.mending import Numbers, mended, named_streams
from prbench.curation.stream_checks import examine_streams
from prbench.entry_points import CORPORA, load_built_in
from prbench.errors import InputFileError, PrbenchError
from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import load_manifest
from prbench.protocol.published import QUANTITIES, Spread
from prbench.readers import AnnotationCounts, CountsAnnotations, RecordingFiles, reader_for
from prbench.readers.discover import BrokenDataset, Discovery, FoundDataset, discover
from prbench.readers.extents import damage
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import FILE_NAME as DATASET_FILE
from prbench.sequences.table import table_statistics, why_no_sequences

State = Literal["complete", "cut short", "incomplete", "damaged", "left out", "unreadable", "inconsistent"]


_Progress = Callable[[int, int, str], None]
# Numbers of --shift and of --scale.
_Mends = tuple[Numbers, Numbers]


def look(root: Path) -> tuple[Discovery, tuple[Any, ...]]:
    """Look for datasets and corpora (``prbench_adapters.corpora.sources.FoundCorpus``) below a folder.

    Raises:
        InputFileError: if there is neither.
    """
    corpora = load_built_in(CORPORA, "find")(root) if root.is_dir() else ()
    try:
        return discover(root), corpora
    except InputFileError:
        if not corpora:  # a folder of corpora alone is no folder of datasets, and still worth a list
            raise
        return Discovery((), ()), corpora


@dataclass(frozen=True)
class InspectedRecording:
    """One recording and what is wrong with it.

    Attributes:
        recording_id: Its name.
        state: The worst of what was found; ``left out`` for a recording that is known to be bad, ``inconsistent`` for
            one whose streams do not belong together.
        size: Bytes of all files that reading it depends on.
        remarks: Missing and damaged files, streams that end early, or what reading said.
    """

    recording_id: str
    state: State
    size: int
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class InspectedDataset:
    """One dataset below the folder.

    Attributes:
        name: Name of the dataset; ``synthetic-`` stands before that of synthetic people.
        title: Its title.
        root: Its folder.
        recordings: All of its recordings.
        size: Bytes of all of its files; what several recordings share counts once.
        annotations: Numbers of its annotations, where they can be counted without its streams.
    """

    name: str
    title: str
    root: Path
    recordings: tuple[InspectedRecording, ...]
    size: int
    annotations: AnnotationCounts | None = None


@dataclass(frozen=True)
class InspectedTable:
    """One built table.

    Attributes:
        folder: The table.
        dataset: Name of the dataset.
        sequences: Number of sequences.
        by_split: Number of sequences of each split.
        participants_in_two_splits: People with sequences in both train and test.
        pose_sources: Sources of the bodies.
        quantities: Mean and standard deviation of ``duration``, ``prime_gap`` (s), ``body_movement`` and
            ``hand_movement`` (m).
        remarks: Why there are no sequences, and recordings that are cut short.
    """

    folder: Path
    dataset: str
    sequences: int
    by_split: dict[str, int]
    participants_in_two_splits: int
    pose_sources: tuple[str, ...]
    quantities: dict[str, Spread]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Inspection:
    """Everything that was found.

    Attributes:
        datasets: Datasets that were found.
        broken: Folders that are recognised and cannot be listed.
        tables: Built tables among the folders.
    """

    datasets: tuple[InspectedDataset, ...]
    broken: tuple[BrokenDataset, ...]
    tables: tuple[InspectedTable, ...] = ()

    @property
    def all_complete(self) -> bool:
        """Return True if nothing is missing, damaged, cut short or unreadable, apart from what is left out."""
        states = {recording.state for dataset in self.datasets for recording in dataset.recordings}
        return not self.broken and states <= {"complete", "left out"}


def inspect_folders(
    folders: Sequence[Path], *, thorough: bool = False, mends: _Mends = ((), ()), progress: _Progress | None = None
) -> Inspection:
    """Look at built tables and at every recording below other folders.

    Args:
        folders: Tables, datasets, or folders that hold several datasets.
        thorough: Read every recording as a build would (:func:`inspect_folder`).
        mends: See there.
        progress: Called with done, total and the recording's name.

    Raises:
        TableError: if a table is damaged or of an unknown version.
        InputFileError: if nothing is recognised in one of the folders.
    """
    tables = [folder for folder in folders if (folder / DATASET_FILE).exists()]
    others = [folder for folder in folders if folder not in tables]
    found = [inspect_folder(folder, thorough=thorough, mends=mends, progress=progress) for folder in others]
    return Inspection(
        tuple(dataset for each in found for dataset in each.datasets),
        tuple(broken for each in found for broken in each.broken),
        tuple(map(_inspect_table, tables)),
    )


def _inspect_table(folder: Path) -> InspectedTable:
    table = SequenceTable.open(folder)
    statistics = table_statistics(table)
    counts = table.info.counts
    remarks = []
    if not counts.sequences:
        remarks.append(f"no sequences. {why_no_sequences(table.info)}")
    if counts.recordings_cut_short:
        said = f"{counts.recordings_cut_short} of {counts.recordings_read} recordings are cut short: a stream of theirs"
        remarks.append(f"{said} ends before the others, and events may be missing. Messages in `recordings` name it.")
    if table.info.synthetic:
        remarks.append("synthetic sequences imitate the study's means; counts and scores are not comparable with them.")
    by_split = {split: statistics.by_split[split] for split in ("train", "validation", "test")}
    counted = (statistics.dataset, statistics.sequences, by_split, statistics.participants_in_two_splits)
    quantities = {name: statistics.spread(name) for name in QUANTITIES}
    return InspectedTable(folder, *counted, statistics.pose_sources, quantities, tuple(remarks))


@foreign_input()
def inspect_folder(
    root: Path | str, *, thorough: bool = False, mends: _Mends = ((), ()), progress: _Progress | None = None
) -> Inspection:
    """Look at every recording below a folder.

    Args:
        root: A dataset's folder, or one that holds several.
        thorough: Read every recording as a build would, and every row of its trajectory, instead of looking for its
            files and at their ends; then examine whether its streams belong together.
        mends: Numbers of ``--shift`` and of ``--scale``, for the recordings that are read.
        progress: Called with done, total and the recording's name.

    Raises:
        InputFileError: if nothing is recognised.
    """
    root = Path(root)
    discovery, corpora = look(root)
    # Counted before the first recording is read: with --thorough each is read in full, and progress needs a total.
    total = sum(len(found.recordings) for found in discovery.found)
    datasets = []
    done = 0
    for found in discovery.found:
        inspected = []
        for recording in found.recordings:
            state, remarks = _inspect(found, recording, thorough, mends)
            size = sum(file.size for file in recording.files)
            inspected.append(InspectedRecording(recording.recording_id, state, size, remarks))
            done += 1
            if progress is not None:
                progress(done, total, recording.recording_id)
        title = load_manifest(found.dataset).title
        reader = reader_for(found.dataset)
        counts = None
        with contextlib.suppress(InputFileError):  # the recordings tell which file is damaged
            counts = reader.annotation_counts(found.recordings) if isinstance(reader, CountsAnnotations) else None
        sizes = {(file.path, file.member): file.size for recording in found.recordings for file in recording.files}
        whole = sum(sizes.values())
        datasets.append(InspectedDataset(found.name, title, found.root, tuple(inspected), whole, counts))
    # Corpora tell while they are searched which of their recordings cannot be used.
    for corpus, folder, found in corpora:
        inspected = [
            InspectedRecording(each.identity.recording_id, "left out", each.input_bytes, (each.skip_reason,))
            if each.skip_reason
            else InspectedRecording(each.identity.recording_id, "complete", each.input_bytes, ())
            for each in found
        ]
        title = load_manifest(corpus).title
        size = sum(each.size for each in inspected)
        datasets.append(InspectedDataset(found[0].identity.dataset, title, folder, tuple(inspected), size))
    return Inspection(tuple(datasets), discovery.broken)


def _inspect(
    found: FoundDataset, recording: RecordingFiles, thorough: bool, mends: _Mends
) -> tuple[State, tuple[str, ...]]:
    """Return the state of one recording, and what is wrong with it."""
    manifest = load_manifest(found.dataset)
    if reason := recording.skip_reason or manifest.why_bad(recording.recording_id):
        return "left out", (reason,)
    missing = tuple(f"missing: {name}" for name in missing_files(recording, manifest.required_roles))
    if readers.lacks_mark(recording.recording_id, recording.dataset):
        missing += (f"missing: {readers.SYNTHETIC_FILE}",)
    reader = reader_for(found.dataset)
    if not missing and isinstance(reader, readers.NamesFurtherFiles):
        try:
            reader.require_further(recording)
        except InputFileError as error:
            missing += (f"missing: {error}",)
    remarks = tuple(f"without {name}" for name in missing_files(recording, manifest.wanted_roles))
    damaged = tuple(f"{file.path.name}: {text}" for file in recording.files if (text := damage(file)))
    # A missing file outranks a damaged one: it has to be downloaded anyway.
    if missing or damaged:
        return ("incomplete" if missing else "damaged"), missing + damaged + remarks
    if not thorough:
        shortfalls = readers.cut_short(recording)
        return ("cut short" if shortfalls else "complete"), shortfalls + remarks
    try:
        read = reader.read(recording)
        read = replace(read, shortfalls=readers.cut_short(recording, read))
        read = mended(read, *mends)
        findings = examine_streams(read, named_streams(read.recording_id, *mends))
    except PrbenchError as error:
        return "unreadable", (str(error),)
    shortfalls = read.shortfalls
    remarks = (*map(str, findings), *read.remarks)
    if any(each.certain for each in findings):
        # A file whose clock is off ends early, too, and no download would mend it.
        return "inconsistent", remarks
    return ("cut short" if shortfalls else "complete"), shortfalls + remarks


def missing_files(recording: RecordingFiles, roles: Mapping[str, str]) -> tuple[str, ...]:
    """Return the files that a recording lacks of those that a manifest requires or wants, by its names for them."""
    present = [file.role for file in recording.files]
    lacking = {key for key in roles if not any(fnmatch.filter(present, pattern) for pattern in key.split("|"))}
    return tuple(name for patterns, name in roles.items() if patterns in lacking)
