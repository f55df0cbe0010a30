"""The contents of an imported dataset: the rows of its three tables, and its ``dataset.json`` with the terms of use.

Sequences are converted one by one while they are written, so that memory does not grow with the motions.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa

import prbench
from prbench.errors import InputFileError
from prbench.files.storage import file_digest, read_json, text_digest
from prbench.protocol.manifests import Manifest, digest_of, load_citations, load_protocol
from prbench.release.candidates import Candidate, Found
from prbench.release.interpret import Interpreted
from prbench.release.known import SYNTHETIC_PREFIX
from prbench.release.layout import EXPORT_RECORD
from prbench.release.report import Inference
from prbench.release.rows import Reading, RowNames, make_row
from prbench.release.survey import Measured
from prbench.sequences.dataset_info import DatasetInfo, FunnelCounts, QuarantinedRecording
from prbench.sequences.redistribution import strictest
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.sequences.sequence import (
    OUTCOMES,
    EventRecord,
    RecordingRecord,
    event_batch,
    recording_batch,
    sequence_batch,
)

_ROWS = 64  # sequences that are converted at once
_STUDY_TERMS = "Prime and Reach release (its page states no licence known to prbench; ask its authors)"
_STUDY_REDISTRIBUTION = "non-commercial"
"""Our assumption, since the study states no terms of its own contribution: the terms of most of its datasets."""


@dataclass(frozen=True)
class _Member:
    """One sequence of a recording."""

    candidate: Candidate
    names: RowNames


@dataclass(frozen=True)
class Terms:
    """Title, licence, redistribution, homepage and citation, as ``dataset.json`` has them."""

    title: str
    licence: str
    redistribution: str
    homepage: str
    citation: str
    synthetic: bool


class ImportedRows:
    """Sequences in table order, each read when it is written; events follow from them, recordings are known before.

    Raises:
        InputFileError: if two entries state the same sequence id.
    """

    def __init__(self, reading: Reading, measured: Sequence[Measured], found: Found) -> None:
        self._reading = reading
        self._events: list[EventRecord] = []
        named = [(reading.names(each.candidate), each) for each in measured]
        # Tables are sorted by id, so that a release in another order gives the same bytes.
        named.sort(key=lambda pair: pair[0].sequence_id)
        _require_distinct([names for names, _ in named])
        self.measured = [each for _, each in named]
        members = [_Member(each.candidate, names) for names, each in named]
        self.records = [*_read(members, reading.fps), *_failed(found)]

    def sequences(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows of ``sequences``."""
        for start in range(0, len(self.measured), _ROWS):
            rows = [make_row(self._reading, each) for each in self.measured[start : start + _ROWS]]
            self._events += [event for _, event in rows]
            yield sequence_batch(sequence for sequence, _ in rows)

    def events(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows of ``events``; complete only after all sequences were read."""
        yield event_batch(sorted(self._events, key=lambda event: event.event_id))

    def recordings(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows of ``recordings``."""
        yield recording_batch(self.records)


def _require_distinct(names: Sequence[RowNames]) -> None:
    for one, other in itertools.pairwise(names):
        if one.sequence_id == other.sequence_id:
            raise InputFileError(
                "target_information.json", one.sequence_id, expected="one entry", found="two with this sequence_id"
            )


def _read(members: Sequence[_Member], fps: float) -> list[RecordingRecord]:
    """Return source recordings where the release names them, else one unknown recording for each split."""
    recordings: dict[str, list[_Member]] = defaultdict(list)
    for member in members:
        recordings[member.names.recording_id].append(member)
    return [
        RecordingRecord(
            recording_id=name,
            participant_id=rows[0].names.participant_id,
            # A recording has one split in our tables; where a release mixes them, the commoner one stands and a
            # message says so.
            split=Counter(row.candidate.subset for row in rows).most_common(1)[0][0],
            split_group=rows[0].names.split_group,
            duration=sum((row.candidate.n_frames - 1) / fps for row in rows),
            outcomes={"sequence": len(rows)},
            status="read",
            message=_message(rows),
        )
        for name, rows in sorted(recordings.items())
    ]


def _message(rows: Sequence[_Member]) -> str:
    if len({row.candidate.subset for row in rows}) > 1:
        return "its sequences stand in more than one split"
    if not rows[0].names.recording_is_known:
        return "the release does not say which recording a sequence comes from"
    return ""


def _failed(found: Found) -> list[RecordingRecord]:
    """Return one failed record, with its reason, for each sequence that was left out."""
    return [
        RecordingRecord(
            recording_id=f"sequence {key}",
            participant_id="unknown",
            split="",
            split_group="",
            duration=0.0,
            outcomes={},
            status="failed",
            message=reason,
        )
        for key, reason in sorted(found.left_out.items())
    ]


def read_export_record(folder: Path) -> dict[str, Any] | None:
    """Read the record that our own exporter left in a dataset's folder, or None.

    Raises:
        InputFileError: if it is no JSON.
    """
    if not (folder / EXPORT_RECORD).is_file():
        return None
    record = read_json(folder / EXPORT_RECORD)
    return record if isinstance(record, dict) else None


def terms_of(dataset: str, manifest: Manifest, exported: Mapping[str, Any] | None) -> Terms:
    """The terms of an imported dataset.

    Data that our exporter wrote are no part of the study's release; what its record says can make terms stricter than
    the manifest's, never looser.
    """
    if dataset.startswith(SYNTHETIC_PREFIX):
        return Terms(
            title=f"Invented recordings in the layout of {manifest.title}",
            licence="MIT (invented by prbench, no recorded person)",
            redistribution="yes",
            homepage="",
            citation="",
            synthetic=True,
        )
    source = Terms(
        title=manifest.title,
        licence=manifest.licence,
        redistribution=manifest.redistribution,
        homepage=manifest.homepage,
        citation=manifest.citation.strip(),
        synthetic=False,
    )
    if exported is not None:
        # The record lies beside the data and anybody can edit it, so it may only make the terms stricter.
        stated = str(exported.get("redistribution", source.redistribution))
        return replace(source, redistribution=strictest([source.redistribution, stated]))
    return replace(
        source,
        title=f"{source.title}, as released with Prime and Reach",
        licence=f"{source.licence} (source recordings); {_STUDY_TERMS}",
        redistribution=strictest([source.redistribution, _STUDY_REDISTRIBUTION]),
        citation=f"{load_citations().study.strip()}\n\n{source.citation}",
    )


def describe(
    dataset: str,
    manifest: Manifest,
    terms: Terms,
    interpreted: Interpreted,
    inferences: tuple[Inference, ...],
    rows: ImportedRows,
) -> DatasetInfo:
    """Describe an import: every inference stands among its options; the writer fills in the digests."""
    protocol = load_protocol()
    n = len(rows.measured)
    failed = [record for record in rows.records if record.status == "failed"]
    return DatasetInfo(
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=dataset,
        title=terms.title,
        synthetic=terms.synthetic,
        prbench_version=prbench.__version__,
        manifest_digest=digest_of(manifest),
        input_digest=_input_digest(interpreted, rows),
        options=_options(interpreted, inferences),
        counts=_counts(rows, len(failed)),
        outcomes={outcome: n if outcome == "sequence" else 0 for outcome in OUTCOMES},
        quarantine=tuple(
            QuarantinedRecording(recording_id=record.recording_id, status=record.status, message=record.message)
            for record in failed
        ),
        # Filled in by the writer, which sees every row.
        identity_digest="",
        content_digest="",
        licence=terms.licence,
        redistribution=terms.redistribution,
        homepage=terms.homepage,
        citation=terms.citation,
    )


def _counts(rows: ImportedRows, failed: int) -> FunnelCounts:
    # A release holds sequences alone, so every event has passed all stages.
    n = len(rows.measured)
    return FunnelCounts(
        recordings_found=len(rows.records),
        recordings_read=len(rows.records) - failed,
        recordings_failed=failed,
        recordings_skipped=0,
        events=n,
        located=n,
        primed=n,
        long_enough=n,
        moved_enough=n,
        sequences=n,
    )


def _options(interpreted: Interpreted, inferences: tuple[Inference, ...]) -> dict[str, str]:
    goal_frame = next(each.value for each in inferences if each.name == "goal_frame")
    options = {"source": "release", "goal_frame": goal_frame, "in_hand_rule": "the release's own events"}
    options |= {f"release.{each.name}": each.text for each in inferences}
    for choice in interpreted.fields:
        options[f"release.field.{choice.canonical}"] = f"{choice.field} ({choice.certainty}: {choice.evidence})"
    return options


def _input_digest(interpreted: Interpreted, rows: ImportedRows) -> str:
    """Return the digest of ``target_information.json`` and of the arrays of every imported sequence."""
    arrays = []
    for each in rows.measured:
        arrays += [str(each.candidate.index), each.digest]
    return text_digest(file_digest(interpreted.files.targets), *arrays)
