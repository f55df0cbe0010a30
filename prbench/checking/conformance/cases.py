"""The sequences that a method of prime-and-reach is asked about: of a table, or of synthetic people made in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np

from prbench.files.storage import atomic_path
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.harness.conditions import ConditionSource
from prbench.harness.planning import rows_of, select
from prbench.protocol.manifests import load_protocol
from prbench.sequences import DatasetInfo, Recording, Sequence, SequenceTable
from prbench.sequences.dataset_info import FILE_NAME as INFO_FILE
from prbench.sequences.dataset_info import FunnelCounts
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.sequences.sequence import recording_batch, sequence_batch
from prbench.sequences.write import write_dataset
from prbench.synthetic.people.perform import name_of_recording, perform
from prbench.synthetic.people.world import Source, assign
from prbench.synthetic.performance import FPS, PREROLL, Performance, TrueClip, sample_joints, true_clips

DATASET = "synthetic-conformance"
_PRESET = "adt"
_SEED = 2024  # differs from that of the embedded table, whose people a method may have learnt from
_RATE = 60.0
_CLIPS_OF_ONE = 6  # sequences a recording, so that several people are seen


def synthetic_sequences(split: str, number: int) -> list[Sequence]:
    """The first sequences of a split, by id; equal in every process.

    Args:
        split: ``train``, ``validation`` or ``test``; no person and no room is in two of them.
        number: How many.
    """
    return sorted(islice(_sequences(split), number), key=lambda sequence: sequence.sequence_id)


def _sequences(split: str) -> Iterator[Sequence]:
    source = Source(_SEED, _PRESET, "default")
    for index in count():
        if assign(source, index).split != split:
            continue
        performance = perform(_PRESET, seed=_SEED, index=index, rate=_RATE, provocations={})
        for clip in true_clips(performance)[:_CLIPS_OF_ONE]:
            event = clip.event
            assert event.prime_time is not None  # clips are made of primed events only
            name = name_of_recording(_PRESET, _SEED, performance.index)
            protocol = load_protocol()
            yield Sequence(
                sequence_id=f"{DATASET}/{name}/{event.object_id}/{event.action}/{event.event_time:.6f}",
                dataset=DATASET,
                recording_id=name,
                participant_id=performance.person.participant_id,
                split=split,
                split_group=name,
                action=event.action,
                object_id=event.object_id,
                object_name=event.object_name,
                text=protocol.text[event.action],
                hand=event.hand,
                fps=FPS,
                n_frames=len(clip.joints),
                start_time=clip.start,
                prime_time=event.prime_time,
                event_time=event.event_time,
                prime_frame=round(PREROLL * FPS),
                prime_gap=event.event_time - event.prime_time,
                preroll=clip.prime_after,
                prime_kind=event.prime_kind or "hit",
                prime_time_uncertainty=1 / performance.rate,
                goal_box_world_min=event.box_min,
                goal_box_world_max=event.box_max,
                body_movement=clip.body_movement,
                hand_movement=clip.hand_movement,
                pose_source="invented",
                head_tilt_deg=clip.neck_tilt_deg,
                previous_source="recorded",
                next_source="recorded",
                head_position=None,
                head_rotation=None,
                gaze_valid=np.ones(len(clip.joints), dtype=bool),
                **_in_canonical_frame(performance, clip),
            )


def _in_canonical_frame(performance: Performance, clip: TrueClip) -> dict[str, Any]:
    """The columns that change with the frame, by name; gaze is that of the performance's nearest sample."""
    world_from_canonical = canonical_frame(clip.joints)
    canonical_from_world = invert_rigid(world_from_canonical)

    def pose(time: float) -> np.ndarray:
        return transform_points(canonical_from_world, sample_joints(performance, np.array([time]))[0])

    frame_times = clip.start + np.arange(len(clip.joints)) / FPS
    nearest = np.searchsorted(performance.times, frame_times - 0.5 / performance.rate)
    nearest = np.minimum(nearest, len(performance.times) - 1)
    return {
        "world_from_canonical": world_from_canonical,
        "goal_location": transform_points(canonical_from_world, clip.event.goal),
        "joints": transform_points(canonical_from_world, clip.joints).astype(np.float32),
        "previous_joints": pose(clip.start - 1 / FPS).astype(np.float32),
        "next_joints": pose(clip.event.event_time + 1 / FPS).astype(np.float32),
        "gaze_origin": transform_points(canonical_from_world, performance.eye[nearest]),
        "gaze_direction": performance.gaze[nearest] @ world_from_canonical[:3, :3],
    }


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
    from prbench.checking.conformance.cases import synthetic_sequences  # late: its imports take 0.5 s

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
    from prbench.checking.conformance.cases import synthetic_sequences

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
