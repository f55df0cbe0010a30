"""The sequences that a method is asked about, and a table to learn from for methods that learn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prbench.files.storage import atomic_path
from prbench.harness.conditions import ConditionSource
from prbench.harness.planning import rows_of, select
from prbench.protocol.manifests import load_protocol
from prbench.sequences import DatasetInfo, Recording, Sequence, SequenceTable
from prbench.sequences.dataset_info import FILE_NAME as INFO_FILE
from prbench.sequences.dataset_info import FunnelCounts
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.sequences.sequence import recording_batch, sequence_batch
from prbench.sequences.write import write_dataset

SEQUENCES = 12
"""Asked about, unless a method is slow."""
_TO_LEARN_FROM = 12
_KEPT = "cases.npz"


@dataclass(frozen=True)
class Cases:
    """The sequences that methods are asked about, sorted by length."""

    source: ConditionSource
    train_folder: Path | None
    """A dataset that has training sequences; None if it is made when a method asks for it."""


def synthetic_cases() -> Cases:
    """Make twelve sequences of synthetic people, the same in every process."""
    from prbench.checking.conformance.synthetic_people import synthetic_sequences  # late: its imports take 0.5 s

    return cases_of(synthetic_sequences("test", SEQUENCES))


def kept_synthetic_cases(folder: Path) -> Cases:
    """Return the synthetic cases of a check: the first process makes and keeps them, later ones read the same numbers.

    Args:
        folder: Of this check alone.
    """
    kept = folder / _KEPT
    if not kept.is_file():
        cases = synthetic_cases()
        with atomic_path(kept) as temporary, open(temporary, "wb") as file:
            fields = vars(cases.source).items()
            values: dict[str, Any] = {name: np.asarray(value) for name, value in fields if value is not None}
            np.savez(file, **values)
        return cases
    with np.load(kept) as arrays:
        read: dict[str, Any] = dict(arrays)
    for name in ("sequence_ids", "text"):
        read[name] = tuple(read[name].tolist())
    read["fps"] = float(read["fps"])
    return Cases(ConditionSource(**read), None)


def cases_of(sequences: list[Sequence]) -> Cases:
    """Make cases of these sequences."""
    return Cases(_by_length(_source(sequences)), None)


def cases_of_table(folder: Path) -> Cases:
    """Choose twelve test sequences of a table, chosen as ``--limit`` does.

    Raises:
        TableError: if there is no such table, or it has no test sequences.
    """
    table = SequenceTable.open(folder).with_sequences()
    return Cases(_by_length(ConditionSource.read(select(table, split="test", limit=SEQUENCES))), folder)


def write_training_table(folder: Path) -> Path:
    """Write a dataset of twelve synthetic training sequences, for methods that learn before they generate.

    A dataset that an earlier process of the check has written there stays: it is the same.
    """
    if (folder / INFO_FILE).is_file():
        return folder
    from prbench.checking.conformance.synthetic_people import synthetic_sequences

    return write_sequences(folder, synthetic_sequences("train", _TO_LEARN_FROM))


def write_sequences(folder: Path, sequences: list[Sequence]) -> Path:
    """Write a dataset of synthetic sequences, sorted by id."""
    recordings = {row.recording_id: row for row in sequences}
    records = [
        Recording(name, row.participant_id, row.split, name, 0.0, {}, "read", "")
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
