"""Rows of the three tables of an imported dataset, converted sequence by sequence."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pyarrow as pa

from prbench.errors import InputFileError
from prbench.release.candidates import Candidate, Found
from prbench.release.rows import Reading, RowNames, make_row
from prbench.release.survey import Measured
from prbench.sequences.sequence import EventRecord, RecordingRecord, event_batch, recording_batch, sequence_batch

_ROWS = 64  # sequences that are converted at once


@dataclass(frozen=True)
class _Member:
    """One sequence of a recording."""

    candidate: Candidate
    names: RowNames


class ImportedRows:
    """Sequences in table order, each read when it is written; events follow from them, recordings are known before.

    Raises:
        InputFileError: if two entries state the same sequence id.
    """

    def __init__(self, reading: Reading, measured: Sequence[Measured], found: Found) -> None:
        self._reading = reading
        self._events: list[EventRecord] = []
        named = [(reading.names(each.candidate), each) for each in measured]
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
