"""One sequence, one event, one recording as curation makes them, and their Arrow rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from prbench.sequences.schema import EVENTS, KEY_VALUES, OUTCOMES, RECORDINGS, SEQUENCES

FrameSource = Literal["recorded", "extrapolated", "copied"]


@dataclass(frozen=True)
class Sequence:
    """One row of the sequence table. Canonical frame unless a name says ``world``; metres, seconds."""

    sequence_id: str
    dataset: str
    recording_id: str
    participant_id: str
    split: str
    split_group: str
    action: str
    object_id: str
    object_name: str
    text: str
    hand: str | None
    fps: float
    n_frames: int
    start_time: float
    prime_time: float
    event_time: float
    prime_frame: int
    prime_gap: float
    preroll: float
    prime_kind: str
    prime_time_uncertainty: float
    goal_location: Float[np.ndarray, "3"]
    goal_box_world_min: Float[np.ndarray, "3"]
    goal_box_world_max: Float[np.ndarray, "3"]
    body_movement: float
    hand_movement: float
    pose_source: str
    head_tilt_deg: float
    joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "22 3"]
    previous_source: FrameSource
    next_joints: Float[np.ndarray, "22 3"]
    next_source: FrameSource
    head_position: Float[np.ndarray, "n 3"] | None
    head_rotation: Float[np.ndarray, "n 4"] | None
    gaze_origin: Float[np.ndarray, "n 3"]
    gaze_direction: Float[np.ndarray, "n 3"]
    gaze_valid: Bool[np.ndarray, " n"]
    world_from_canonical: Float[np.ndarray, "4 4"]
    extra: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class EventRecord:
    """One row of ``events``: a candidate event and what became of it. World frame."""

    event_id: str
    recording_id: str
    sequence_id: str | None
    object_id: str
    object_name: str
    action: str
    hand: str | None
    event_time: float
    prime_time: float | None
    prime_kind: str | None
    location: Float[np.ndarray, "3"] | None
    box_min: Float[np.ndarray, "3"] | None
    box_max: Float[np.ndarray, "3"] | None
    outcome: str
    stage: str
    """The stage of curation that decided."""
    value: float | None
    """The deciding number."""
    threshold: float | None
    """What it was compared with."""

    def __post_init__(self) -> None:
        assert self.outcome in OUTCOMES, self.outcome


@dataclass(frozen=True)
class RecordingRecord:
    """One row of ``recordings``."""

    recording_id: str
    participant_id: str
    split: str
    split_group: str
    duration: float
    outcomes: Mapping[str, int]
    """Number of events by outcome."""
    status: str
    """``read``, ``failed`` or ``skipped``."""
    message: str


def sequence_batch(sequences: Iterable[Sequence]) -> pa.RecordBatch:
    """Arrow rows of sequences, in the order given."""
    rows = list(sequences)
    columns = [_column([getattr(row, name) for row in rows], SEQUENCES.field(name).type) for name in SEQUENCES.names]
    return pa.RecordBatch.from_arrays(columns, schema=SEQUENCES)


def event_batch(events: Iterable[EventRecord]) -> pa.RecordBatch:
    """Arrow rows of events, in the order given."""
    rows = list(events)
    columns = [_column([getattr(row, name) for row in rows], EVENTS.field(name).type) for name in EVENTS.names]
    return pa.RecordBatch.from_arrays(columns, schema=EVENTS)


def recording_batch(recordings: Iterable[RecordingRecord]) -> pa.RecordBatch:
    """Arrow rows of recordings, in the order given."""
    rows = []
    for recording in recordings:
        row = dataclasses.asdict(recording)
        counts = row.pop("outcomes")
        rows.append(row | {outcome: counts.get(outcome, 0) for outcome in OUTCOMES})
    return pa.RecordBatch.from_pylist(rows, schema=RECORDINGS)


def _column(values: list, kind: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_list(kind):
        return _vectors(values, kind)
    if kind == KEY_VALUES:
        pairs = [[{"key": key, "value": text} for key, text in sorted(value.items())] for value in values]
        return pa.array(pairs, type=kind)
    if pa.types.is_list(kind):
        return _ragged(values, kind)
    return pa.array(values, type=kind)


def _vectors(values: list[np.ndarray | None], kind: pa.FixedSizeListType) -> pa.Array:
    missing = [value is None for value in values]
    filler = np.zeros(kind.list_size)
    flat = [np.ravel(filler if value is None else value) for value in values]
    numbers = np.concatenate(flat) if flat else np.empty(0)
    mask = pa.array(missing, type=pa.bool_()) if any(missing) else None
    return pa.FixedSizeListArray.from_arrays(pa.array(numbers, type=kind.value_type), type=kind, mask=mask)


def _ragged(values: list[np.ndarray | None], kind: pa.ListType) -> pa.Array:
    lengths = [0 if value is None else len(value) for value in values]
    offsets = np.concatenate(([0], np.cumsum(lengths))).astype(np.int32)
    inner = kind.value_type
    present = [value for value in values if value is not None]
    if pa.types.is_fixed_size_list(inner):
        numbers = np.concatenate([np.ravel(value) for value in present]) if present else np.empty(0)
        items = pa.FixedSizeListArray.from_arrays(pa.array(numbers, type=inner.value_type), type=inner)
    else:
        items = pa.array(np.concatenate(present) if present else np.empty(0, dtype=bool), type=inner)
    mask = pa.array([value is None for value in values]) if len(present) < len(values) else None
    return pa.ListArray.from_arrays(pa.array(offsets), items, type=kind, mask=mask)
