"""The unit of work of a corpus build: a group of recordings read and kept as one part."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

import prbench
from prbench.engine import is_out_of_memory
from prbench.errors import InputFileError, PrbenchError
from prbench.files.storage import text_digest
from prbench.protocol.manifests import Manifest, digest_of, load_protocol
from prbench.readers import SYNTHETIC_PREFIX
from prbench.sequences import parts
from prbench.sequences.corpus import (
    ANNOTATION_OUTCOMES,
    CORPUS_SCHEMA_VERSION,
    CorpusRecord,
    annotation_batch,
    clip_batch,
    corpus_recording_batch,
)
from prbench.sequences.dataset_info import CorpusCounts, CorpusInfo, QuarantinedRecording
from prbench.shown import quoted
from prbench_adapters.corpora.sources import CorpusOptions, CorpusRecording, ReadRecording, RecordingGroup


class GroupReceipt(msgspec.Struct, frozen=True, kw_only=True):
    """Description of a finished part, readable without opening its tables."""

    name: str
    input_digest: str
    records: tuple[CorpusRecord, ...]
    clips: int
    captions: int
    approximate_clips: int
    frames: int


@dataclass(frozen=True)
class FinishedGroup:
    """A part and where it lies."""

    folder: Path
    receipt: GroupReceipt
    reused: bool
    """True if an earlier, interrupted build had made it."""


@dataclass(frozen=True)
class CorpusJob:
    """Reads the recordings of a group and writes their part, unless that part is there already."""

    settings: str
    """Digest of everything but the input that decides what comes out."""
    stop_on_error: bool
    work: Path

    def __call__(self, group: RecordingGroup) -> FinishedGroup:
        """Make the part of one group."""
        folder, digest = self._folder(group)
        entries = parts.read_receipt(folder)
        if entries is not None:
            receipt = msgspec.convert(entries, GroupReceipt)
            if all(record.status != "failed" for record in receipt.records):  # a failure may have passed: try again
                return FinishedGroup(folder, receipt, reused=True)
        done = [self._read(recording) for recording in group.recordings]
        return FinishedGroup(folder, self._write(folder, group, digest, done), reused=False)

    def if_full(self, group: RecordingGroup, error: PrbenchError) -> FinishedGroup:
        """Make the part of a group for which the memory does not suffice: nothing of it is read, and it says why."""
        folder, digest = self._folder(group)
        done = [self._failed(recording, error) for recording in group.recordings]
        return FinishedGroup(folder, self._write(folder, group, digest, done), reused=False)

    def _folder(self, group: RecordingGroup) -> tuple[Path, str]:
        """Return the folder of the part, and the digest of its input."""
        try:
            digest = group.input_digest()
        except (OSError, InputFileError) as error:
            digest = text_digest("unreadable", type(error).__name__)
        return parts.part_folder(self.work, group.name, digest, self._settings_of(group)), digest

    def _settings_of(self, group: RecordingGroup) -> str:
        """Splits, participants and reasons to skip come from files that the recordings share, or from the manifest."""
        known = [
            text
            for recording in group.recordings
            for text in (*map(str, vars(recording.identity).values()), recording.skip_reason or "")
        ]
        return text_digest(self.settings, *known)

    def _write(
        self, folder: Path, group: RecordingGroup, digest: str, done: list[tuple[ReadRecording, CorpusRecord]]
    ) -> GroupReceipt:
        clips = [clip for read, _ in done for clip in sorted(read.clips, key=lambda clip: clip.sequence_id)]
        batches = {
            "clips": clip_batch(clips),
            "annotations": annotation_batch(row for read, _ in done for row in read.annotations),
            "recordings": corpus_recording_batch(record for _, record in done),
        }
        receipt = GroupReceipt(
            name=group.name,
            input_digest=digest,
            records=tuple(record for _, record in done),
            clips=len(clips),
            captions=sum(len(clip.captions) for clip in clips),
            approximate_clips=sum(clip.approximate for clip in clips),
            frames=sum(clip.n_frames for clip in clips),
        )
        parts.write_part(folder, batches, parts.plain(receipt))
        return receipt

    def _read(self, recording: CorpusRecording) -> tuple[ReadRecording, CorpusRecord]:
        if recording.skip_reason is not None:
            return _left_out(recording, "skipped", recording.skip_reason)
        try:
            read = recording.read()
        except Exception as error:
            if is_out_of_memory(error):
                raise  # the engine tries again when nothing else is done beside it
            # Whatever one recording does, the others go on; its message reaches the user with the build's report.
            return self._failed(recording, error)
        outcomes = Counter(row.outcome for row in read.annotations)
        return read, _record(recording, read, outcomes, "read", read.message)

    def _failed(self, recording: CorpusRecording, error: Exception) -> tuple[ReadRecording, CorpusRecord]:
        known = isinstance(error, PrbenchError)
        name = recording.identity.recording_id
        if self.stop_on_error:
            if known:
                raise error
            raise PrbenchError(f"{name}: unexpected {type(error).__name__}: {quoted(error)}") from error
        message = str(error) if known else f"unexpected {type(error).__name__}: {quoted(error)}"
        return _left_out(recording, "failed", recording.without_places(message))


def describe(
    dataset: str,
    manifest: Manifest | None,
    described: Mapping[str, str],
    options: CorpusOptions,
    receipts: Sequence[GroupReceipt],
) -> CorpusInfo:
    """Provenance of a build; its two digests are filled in when the tables are written."""
    synthetic = dataset.startswith(SYNTHETIC_PREFIX)
    protocol = load_protocol()
    outcomes = Counter[str]()
    for receipt in receipts:
        for record in receipt.records:
            outcomes.update(record.outcomes)
    real = None if synthetic else manifest
    return CorpusInfo(
        schema_version=CORPUS_SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=dataset,
        title=_title(manifest, synthetic=synthetic),
        synthetic=synthetic,
        prbench_version=prbench.__version__,
        manifest_digest="" if manifest is None else digest_of(manifest),
        input_digest=text_digest(*(text for receipt in receipts for text in (receipt.name, receipt.input_digest))),
        options={
            "recordings": options.recordings,
            "limit": "all" if options.limit is None else str(options.limit),
            **described,
        },
        counts=_counts(receipts, outcomes),
        outcomes={outcome: outcomes[outcome] for outcome in ANNOTATION_OUTCOMES},
        quarantine=tuple(
            QuarantinedRecording(recording_id=record.recording_id, status=record.status, message=record.message)
            for receipt in receipts
            for record in receipt.records
            if record.status != "read"
        ),
        identity_digest="",
        content_digest="",
        licence="MIT (invented by prbench, no recorded person)" if real is None else real.licence,
        redistribution="yes" if real is None else real.redistribution,
        homepage="" if real is None else real.homepage,
        citation="" if real is None else real.citation.strip(),
    )


def _title(manifest: Manifest | None, *, synthetic: bool) -> str:
    if manifest is None:
        return "Invented people and what they do"
    return f"Invented recordings in the layout of {manifest.title}" if synthetic else manifest.title


def _counts(receipts: Sequence[GroupReceipt], outcomes: Counter[str]) -> CorpusCounts:
    statuses = Counter(record.status for receipt in receipts for record in receipt.records)
    return CorpusCounts(
        recordings_found=sum(statuses.values()),
        recordings_read=statuses["read"],
        recordings_failed=statuses["failed"],
        recordings_skipped=statuses["skipped"],
        annotations=sum(outcomes.values()),
        clips=sum(receipt.clips for receipt in receipts),
        captions=sum(receipt.captions for receipt in receipts),
        approximate_clips=sum(receipt.approximate_clips for receipt in receipts),
        frames=sum(receipt.frames for receipt in receipts),
    )


def _left_out(
    recording: CorpusRecording, status: Literal["failed", "skipped"], message: str
) -> tuple[ReadRecording, CorpusRecord]:
    nothing = ReadRecording((), (), 0.0, clock_method="none")
    return nothing, _record(recording, nothing, Counter(), status, message)


def _record(
    recording: CorpusRecording, read: ReadRecording, outcomes: Counter[str], status: str, message: str
) -> CorpusRecord:
    identity = recording.identity
    return CorpusRecord(
        recording_id=identity.recording_id,
        participant_id=identity.participant_id,
        split=identity.split,
        split_group=identity.split_group,
        duration=read.duration,
        outcomes=dict(outcomes),
        clock_method=read.clock_method,
        clock_quality=read.clock_quality,
        status=status,
        message=message,
        measured=dict(read.measured),
    )
