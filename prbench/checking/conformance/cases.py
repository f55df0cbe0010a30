"""The sequences that a method is asked about, and a table to learn from for methods that learn."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prbench.evaluation.conditions import ConditionSource
from prbench.evaluation.planning import select
from prbench.manifests import load_protocol
from prbench.sequences import DatasetInfo, RecordingRecord, Sequence, SequenceTable
from prbench.sequences.dataset_info import FunnelCounts
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.sequences.sequence import recording_batch, sequence_batch
from prbench.sequences.write_dataset import write_dataset

SEQUENCES = 12
"""Asked about, unless a method is slow."""
_TO_LEARN_FROM = 12


@dataclass(frozen=True)
class Cases:
    """What methods are asked about, in the order of length."""

    source: ConditionSource
    train_folder: Path | None
    """A dataset that has training sequences; None: invented when a method asks for it."""


def invented_cases() -> Cases:
    """Twelve sequences of people who do not exist; the same in every process."""
    from prbench.checking.conformance.people import (
        invented_sequences,
    )  # inventing people takes half a second to import

    return cases_of(invented_sequences("test", SEQUENCES))


def cases_of(sequences: list[Sequence]) -> Cases:
    """These sequences."""
    return Cases(_by_length(_source(sequences)), None)


def cases_of_table(folder: Path) -> Cases:
    """Twelve test sequences of a table, chosen as ``--limit`` does.

    Raises:
        TableError: if there is no such table, or it has no test sequences.
    """
    table = SequenceTable.open(folder).with_sequences()
    return Cases(_by_length(ConditionSource.read(select(table, split="test", limit=SEQUENCES))), folder)


def rows_of(source: ConditionSource, rows: SequenceOf[int] | np.ndarray) -> ConditionSource:
    """Some of the sequences, in the order given."""
    chosen = np.asarray(rows, dtype=np.int64)
    changed: dict[str, Any] = {}
    for field in dataclasses.fields(source):
        values = getattr(source, field.name)
        if isinstance(values, tuple):
            changed[field.name] = tuple(values[row] for row in chosen)
        elif isinstance(values, np.ndarray):
            changed[field.name] = values[chosen]
    return dataclasses.replace(source, **changed)


def write_training_table(folder: Path) -> Path:
    """Write a dataset of twelve invented training sequences, for methods that learn before they generate."""
    from prbench.checking.conformance.people import invented_sequences

    return write_sequences(folder, invented_sequences("train", _TO_LEARN_FROM))


def write_sequences(folder: Path, sequences: list[Sequence]) -> Path:
    """Write a dataset of invented sequences, sorted by id."""
    recordings = {row.recording_id: row for row in sequences}
    records = [
        RecordingRecord(name, row.participant_id, row.split, name, 0.0, {}, "read", "")
        for name, row in sorted(recordings.items())
    ]
    write_dataset(
        folder,
        _info(sequences, len(records)),
        sequences=[sequence_batch(sequences)],
        events=[],
        recordings=[recording_batch(records)],
    )
    return folder


def _source(sequences: list[Sequence]) -> ConditionSource:
    return ConditionSource(
        sequence_ids=tuple(row.sequence_id for row in sequences),
        n_frames=np.array([row.n_frames for row in sequences]),
        fps=sequences[0].fps,
        text=tuple(row.text for row in sequences),
        initial_joints=np.stack([row.joints[0] for row in sequences]),
        previous_joints=np.stack([row.previous_joints for row in sequences]),
        goal_joints=np.stack([row.joints[-1] for row in sequences]),
        goal_location=np.stack([row.goal_location for row in sequences]),
        head_tilt_deg=np.array([row.head_tilt_deg for row in sequences]),
    )


def _by_length(source: ConditionSource) -> ConditionSource:
    return rows_of(source, np.argsort(source.n_frames, kind="stable"))


def _info(sequences: list[Sequence], recordings: int) -> DatasetInfo:
    protocol = load_protocol()
    return DatasetInfo(
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=sequences[0].dataset,
        title="Invented people (conformance check)",
        synthetic=True,
        prbench_version="",
        manifest_digest="",
        input_digest="",
        options={},
        counts=FunnelCounts(
            recordings_found=recordings,
            recordings_read=recordings,
            recordings_failed=0,
            recordings_skipped=0,
            events=len(sequences),
            located=len(sequences),
            primed=len(sequences),
            long_enough=len(sequences),
            moved_enough=len(sequences),
            sequences=len(sequences),
        ),
        outcomes={},
        quarantine=(),
        identity_digest="",
        content_digest="",
        licence="none needed: invented",
        redistribution="yes",
        homepage="",
        citation="",
    )
