"""The recordings of a build: where they come from, the work on one of them, and what the table says about them.

Sources are native files of a dataset, or anything else that yields recordings.
"""

from __future__ import annotations

import fnmatch
import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import msgspec
import pyarrow as pa

from prbench import readers
from prbench.curation.corrections import DROPPED, Corrections, UnknownEventError
from prbench.curation.curate import CuratedRecording, curate_recording
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.curation.stream_checks import sound
from prbench.engine import Engine, is_out_of_memory
from prbench.errors import InputFileError, PrbenchError, UsageError
from prbench.files.arrays import first_repeated
from prbench.files.bounded import foreign_input, require
from prbench.files.storage import file_digest, text_digest
from prbench.limits import HARMLESS_SIZE, LARGEST_ARCHIVE, LARGEST_JSON, LARGEST_PICKLE, LARGEST_UNPACKED
from prbench.progress_bar import ProgressCallback
from prbench.protocol.manifests import BenchmarkProtocol, Manifest, digest_of, load_manifest, load_protocol
from prbench.protocol.own_protocol import OPTION
from prbench.readers import RecordingFiles, reader_for
from prbench.recording import Recording
from prbench.sequences import parts
from prbench.sequences.dataset_info import DatasetInfo, FunnelCounts, begun_with, quarantined
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.sequences.sequence import OUTCOMES, SCENES, event_batch, recording_batch, row_batch, sequence_batch
from prbench.sequences.sequence import Recording as RecordingRow
from prbench.shown import clean, quoted

_EVENTS_ONLY = "events_only"  # the reader's option


class RecordingSource(Protocol):
    """One recording that can be read, here or in another process; instances are picklable.

    ``recording_id`` is unique within a build, and ``dataset`` is the name that the recording will carry. ``split`` is
    None where a list or the draw decides, and ``skip_reason`` says why the recording must not be read, if it must not.
    """

    @property
    def dataset(self) -> str: ...  # noqa: D102 - explained above
    @property
    def recording_id(self) -> str: ...  # noqa: D102
    @property
    def split(self) -> str | None: ...  # noqa: D102
    @property
    def skip_reason(self) -> str | None: ...  # noqa: D102

    def input_digest(self) -> str:
        """Digest of everything that reading depends on."""
        ...

    def read(self) -> Recording:
        """Read it."""
        ...

    def without_places(self, message: str) -> str:
        """Return a message without the folders of this machine, so that equal inputs give equal datasets anywhere."""
        ...


@dataclass(frozen=True)
class NativeSource:
    """A recording in a dataset's own files below a folder."""

    root: Path
    found: RecordingFiles
    split: str | None
    skip_reason: str | None
    reader_options: tuple[tuple[str, str], ...] = ()

    @property
    def dataset(self) -> str:
        """See :class:`RecordingSource`."""
        return self.found.dataset

    @property
    def recording_id(self) -> str:
        """See :class:`RecordingSource`."""
        return self.found.recording_id

    @property
    def size(self) -> int:
        """Bytes of all input files."""
        return sum(file.size for file in self.found.files)

    @foreign_input()
    def input_digest(self) -> str:
        """See :class:`RecordingSource`: roles, names and contents of the files, a split of their own, and options."""
        files = sorted(self.found.files, key=lambda file: file.role)
        # No reader takes larger ones, and a digest of what is no file of the dataset would take minutes.
        largest = {".json": LARGEST_JSON, ".pkl": LARGEST_PICKLE, ".txt": HARMLESS_SIZE, ".zip": LARGEST_ARCHIVE}
        paths = {file.path: largest.get(file.path.suffix.lower(), LARGEST_UNPACKED) for file in files}
        digests = {path: file_digest(path, largest=most) for path, most in paths.items()}  # many lie in one archive
        parts = [text for file in files for text in (file.role, file.path.name, file.member, digests[file.path])]
        options = reader_for(self.dataset, dict(self.reader_options)).options
        chosen = [text for item in readers.described_options(options).items() for text in item]
        return text_digest(self.dataset, self.recording_id, self.split or "", *parts, *chosen)

    def read(self) -> Recording:
        """See :class:`RecordingSource`; streams that end before the recording does are named."""
        recording = reader_for(self.dataset, dict(self.reader_options)).read(self.found)
        return replace(recording, shortfalls=readers.cut_short(self.found, recording))

    def without_places(self, message: str) -> str:
        """See :class:`RecordingSource`."""
        root = self.root.expanduser().resolve()
        for folder in (root, root.parent):
            message = message.replace(f"{folder}{os.sep}", "")
        return message


@foreign_input()
def native_sources(dataset: str, root: Path | str, options: BuildOptions) -> tuple[NativeSource, ...]:
    """Return the recordings of a dataset's folder that the options choose, sorted by id.

    Raises:
        UsageError: for a dataset without a reader, or options that it cannot fulfil.
        InputFileError: if there is no recording, or none that matches the glob.
    """
    root = Path(root)
    events_only = dict(options.reader).get(_EVENTS_ONLY) == "true"
    if events_only and _EVENTS_ONLY not in reader_for(dataset).options.names():
        needed = "events are found in its streams, or placed by them, so --events-only is impossible"
        raise UsageError(f"{dataset}: its {needed}; leave it out. It lists those of hd-epic.")
    reader = reader_for(dataset, dict(options.reader))
    manifest = options.manifest_of(dataset)
    options.curation.require_fits(manifest)
    recordings = reader.find(root)
    repeated = first_repeated(recording.recording_id for recording in recordings)
    folders = [str(recording.folder) for recording in recordings if recording.recording_id == repeated]
    twice = f"'{repeated}' in {' and '.join(folders)}"
    remedy = "Move one of the two copies away."
    require(root, (repeated is None, "", "recordings with different names", twice, remedy))
    found = {recording.recording_id: recording for recording in recordings}
    readers.require_one_origin(root, (recording.dataset for recording in found.values()))
    readers.require_marked(root, {name: recording.dataset for name, recording in found.items()})
    tree = readers.read_synthetic_tree(root)
    # Sequence ids, which go on with a slash, then come out sorted.
    in_order = sorted(found, key=lambda name: f"{name}/")
    sources = []
    for name in chosen_ids(in_order, options.recordings, options.limit, where=root):
        files = found[name]
        split = tree.split.get(name) if tree else files.split
        reason = files.skip_reason if events_only else manifest.why_bad(name) or files.skip_reason
        sources.append(NativeSource(root, files, split, reason, options.reader))
    return tuple(sources)


def chosen_ids(recording_ids: SequenceOf[str], glob: str, limit: int | None, *, where: Path | str) -> list[str]:
    """Ids that match the glob, at most ``limit`` of them.

    Raises:
        InputFileError: if none matches, or a recording has a name that no table and no terminal can hold.
    """
    strange = [clean(name) for name in recording_ids if clean(name) != name]
    chosen = [name for name in recording_ids if fnmatch.fnmatchcase(name, glob)]
    shown = ", ".join(recording_ids[:5]) + (" …" if len(recording_ids) > 5 else "")
    others = f"{len(recording_ids)} others: {shown}"
    require(
        where,
        (not strange, "", "recordings whose names can be shown", f"'{''.join(strange[:1])}'", "Rename its files."),
        (chosen != [], "", f"recordings whose name matches '{glob}'", others, "Change the glob of --recordings."),
    )
    return chosen[:limit]


@dataclass(frozen=True)
class PartReceipt:
    """Description of a finished part, readable without opening its tables."""

    folder: Path
    input_digest: str
    record: RecordingRow
    reused: bool  # an earlier, interrupted build had made it


def part_receipt(folder: Path, entries: Mapping[str, Any], *, reused: bool) -> PartReceipt:
    """Turn what stands in a finished part into its description."""
    return PartReceipt(folder, entries["input_digest"], msgspec.convert(entries["record"], RecordingRow), reused)


def message_of(error: Exception, recording_id: str, *, stop: bool) -> str:
    """Say why a recording could not be read; or raise it, where the build shall stop at the first."""
    known = isinstance(error, PrbenchError)
    message = str(error) if known else f"unexpected {type(error).__name__}: {quoted(error)}"
    if stop and known:
        raise error
    if stop:
        raise PrbenchError(f"{recording_id}: {message}") from error
    return message


@dataclass(frozen=True)
class RecordingJob(ABC):
    """Reads one recording and writes its part, unless that part is there already.

    Attributes:
        stop_on_error: Raise what one recording cannot be read for; else it is left out, and its row says why.
        work: Folder of the parts.
    """

    stop_on_error: bool
    work: Path

    @abstractmethod
    def settings(self, source: Any) -> str:
        """Digest of everything but the input that decides what comes out."""

    @abstractmethod
    def make(self, source: Any) -> tuple[RecordingRow, dict[str, pa.RecordBatch]]:
        """Read the recording; return its row, and the rows of each table."""

    @abstractmethod
    def nothing(self, source: Any, record: RecordingRow) -> dict[str, pa.RecordBatch]:
        """Return the tables of a recording of which only the row is known."""

    def __call__(self, source: Any) -> PartReceipt:
        """Make the part of one recording."""
        if source.skip_reason is not None:
            return self._left_out(source, "", "skipped", source.skip_reason)
        try:
            digest = source.input_digest()
        except (OSError, InputFileError) as error:
            # No digest exists of what cannot be read; the part is tried again by the next build.
            return self._failed(source, "unreadable", error)
        folder = self._folder(source, digest)
        if (entries := parts.read_receipt(folder)) is not None:
            found = part_receipt(folder, entries, reused=True)
            if found.record.status != "failed":  # a failure may have passed: try again
                return found
        try:
            record, batches = self.make(source)
        except UnknownEventError:
            raise  # a correction without its event would be lost in silence
        except Exception as error:
            if is_out_of_memory(error):
                raise  # the engine tries again when nothing else is done beside it
            # Whatever one recording does, the others go on; its message reaches the user with the build's report.
            return self._failed(source, digest, error)
        return self._write(source, digest, record, batches)

    def if_full(self, source: Any, error: PrbenchError) -> PartReceipt:
        """Make the part of a recording for which the memory does not suffice: it is not read, and says why."""
        return self._failed(source, source.input_digest(), error)

    def make_all(
        self, sources: SequenceOf[Any], engine: Engine, progress: ProgressCallback | None
    ) -> list[PartReceipt]:
        """Make the parts of some recordings, in their order."""
        receipts: list[PartReceipt] = []
        for receipt in engine.map(self, sources, if_full=self.if_full):
            receipts.append(receipt)
            if progress is not None:
                progress(len(receipts), len(sources), receipt.record.recording_id)
        return receipts

    def _failed(self, source: Any, digest: str, error: Exception) -> PartReceipt:
        message = message_of(error, source.recording_id, stop=self.stop_on_error)
        return self._left_out(source, digest, "failed", source.without_places(message))

    def _left_out(self, source: Any, digest: str, status: str, message: str) -> PartReceipt:
        name = source.recording_id
        record = RecordingRow(name, "unknown", source.split or "", name, 0.0, {}, status, message)
        return self._write(source, digest, record, self.nothing(source, record))

    def _folder(self, source: Any, digest: str) -> Path:
        return parts.part_folder(self.work, source.recording_id, digest, self.settings(source))

    def _write(self, source: Any, digest: str, record: RecordingRow, batches: dict[str, pa.RecordBatch]) -> PartReceipt:
        folder = self._folder(source, digest)
        parts.write_part(folder, batches, {"input_digest": digest, "record": parts.plain(record)})
        return PartReceipt(folder, digest, record, reused=False)


@dataclass(frozen=True)
class CurationJob(RecordingJob):
    """Reads and curates one recording.

    Attributes:
        corrections: Maps each recording with corrected events to its corrections.
    """

    manifest: Manifest
    protocol: BenchmarkProtocol
    options: CurationOptions
    corrections: Mapping[str, Corrections]

    def settings(self, source: RecordingSource) -> str:
        """See :class:`RecordingJob`."""
        corrections = self.corrections.get(source.recording_id)
        options = msgspec.json.encode((self.options, corrections and corrections.rows)).decode()
        return text_digest(digest_of(self.manifest), self.protocol.digest, options)

    def make(self, source: RecordingSource) -> tuple[RecordingRow, dict[str, pa.RecordBatch]]:
        """See :class:`RecordingJob`."""
        recording, findings = sound(source.read(), self.options.shift, self.options.scale)
        about = {"corrections": self.corrections.get(source.recording_id), "findings": findings}
        rules = (self.manifest, self.protocol, self.options)
        curated = curate_recording(recording, *rules, split=source.split or "", **about)
        return curated.record, _tables(curated)

    def nothing(self, source: RecordingSource, record: RecordingRow) -> dict[str, pa.RecordBatch]:  # noqa: ARG002
        """See :class:`RecordingJob`."""
        return _tables(CuratedRecording((), (), record))


def _tables(curated: CuratedRecording) -> dict[str, pa.RecordBatch]:
    tables = {"sequences": sequence_batch(curated.sequences), "events": event_batch(curated.events)}
    return tables | {"recordings": recording_batch([curated.record]), "scenes": row_batch(curated.boxes, SCENES)}


# Outcomes that end an event at each stage, in the order of the stages.
_EXCLUDED = ("excluded_category", "no_location", "tracking_lost")
_STAGES = {
    "located": (DROPPED, "annotation_only", "unreadable_entry", "other_wearer", *_EXCLUDED),
    "primed": ("not_primed", "excluded_by_dataset", "not_published"),
    "long_enough": ("too_short", "no_body"),
    "moved_enough": ("minimum_movement",),
    "sequences": ("low_confidence",),
}


def provenance_of(
    dataset: str, protocol: Any, receipts: SequenceOf[PartReceipt], used: SequenceOf[PartReceipt]
) -> dict[str, Any]:
    """Return the fields of a description that follow from the parts of a build, and the dataset's terms.

    Args:
        dataset: Name of the dataset.
        protocol: Rules of the build.
        receipts: All parts.
        used: The parts whose files make the digest of the input.
    """
    manifest = load_manifest(dataset)
    inputs = (text for each in used for text in (each.record.recording_id, each.input_digest))
    return {
        **manifest.terms(synthetic=dataset.startswith(readers.SYNTHETIC_PREFIX)),
        **begun_with(protocol),
        "dataset": dataset,
        "manifest_digest": digest_of(manifest),
        "input_digest": text_digest(*inputs),
        "quarantine": quarantined(each.record for each in receipts),
    }


def describe(
    dataset: str, options: BuildOptions, receipts: SequenceOf[PartReceipt], extra_options: Mapping[str, str]
) -> DatasetInfo:
    """Provenance of a build; its two digests are filled in when the tables are written."""
    manifest = options.manifest_of(dataset)
    protocol = options.protocol or load_protocol()
    outcomes = sum((Counter(receipt.record.outcomes) for receipt in receipts), Counter[str]())
    statuses = Counter(receipt.record.status for receipt in receipts)
    chosen = {"recordings": options.recordings, "limit": "all" if options.limit is None else str(options.limit)}
    if options.reader:
        reader = reader_for(manifest.name, dict(options.reader))
        chosen |= {f"reader.{name}": value for name, value in readers.described_options(reader.options).items()}
    if options.corrections is not None:
        read = (receipt.record.recording_id for receipt in receipts if receipt.record.status == "read")
        chosen |= options.corrections.described(dataset, read)
    if protocol.is_own:  # tables of prbench's own protocol keep their bytes
        chosen[OPTION] = protocol.label
    # BibTeX of the dataset and, where they are not its own, of the body poses.
    body = manifest.body_source(dict(options.reader).get("poses"))
    about = provenance_of(dataset, protocol, receipts, receipts)
    about["manifest_digest"] = digest_of(manifest)
    about |= manifest.terms(synthetic=about["synthetic"])
    if not about["synthetic"]:
        about["citation"] = "\n\n".join(text.strip() for text in (manifest.citation, body.citation) if text)
    return DatasetInfo(
        **about,
        schema_version=SCHEMA_VERSION,
        options=(chosen | options.curation.described(manifest, protocol)) | dict(extra_options),
        counts=funnel_counts(statuses, outcomes, sum(bool(receipt.record.shortfalls) for receipt in receipts)),
        outcomes={outcome: outcomes[outcome] for outcome in OUTCOMES},
    )


def funnel_counts(statuses: Mapping[str, int], outcomes: Mapping[str, int], cut_short: int = 0) -> FunnelCounts:
    """Count the candidates that each stage left, from recordings by status and events by outcome."""
    left = sum(outcomes.values())
    counts = {"recordings_found": sum(statuses.values()), "recordings_cut_short": cut_short, "events": left}
    counts |= {f"recordings_{status}": statuses.get(status, 0) for status in ("read", "failed", "skipped")}
    for stage, ending in _STAGES.items():
        left -= sum(outcomes.get(name, 0) for name in ending)
        counts[stage] = left
    return FunnelCounts(**counts)


# Name of a stage, how many passed it, how many of those that came to it did not, and counts of these by reason.
FunnelRow = tuple[str, int, int, str]


def funnel_rows(info: DatasetInfo) -> list[FunnelRow]:
    """Return one row a stage, from files found to sequences."""
    counts = info.counts
    outcomes = info.outcomes
    left_out = counts.recordings_failed + counts.recordings_skipped
    told = [f"{counts.recordings_failed} failed, {counts.recordings_skipped} skipped"] if left_out else []
    if counts.recordings_cut_short:
        told.append(f"{counts.recordings_cut_short} of those that were read are cut short: events may be missing")
    rows: list[FunnelRow] = [("recordings found", counts.recordings_found, 0, "")]
    rows.append(("recordings read", counts.recordings_read, left_out, "; ".join(told)))
    rows.append(("candidate events", counts.events, 0, ""))
    before = counts.events
    for stage, names in _STAGES.items():
        kept = getattr(counts, stage)
        reasons = "; ".join(f"{outcomes[name]} {name}: {OUTCOMES[name]}" for name in names if outcomes.get(name))
        rows.append((stage.replace("_", " "), kept, before - kept, reasons))
        before = kept
    return rows
