"""One sequence, one event, one recording as curation makes them, and their Arrow rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from prbench.sequences.chunk import row_batch
from prbench.sequences.schema import EVENTS, OUTCOMES, RECORDINGS, SCENES, SEQUENCES

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
    """Threshold that the value was compared with."""
    left_wrist: Float[np.ndarray, "3"] | None = None
    """Position of the wearer's wrist at the event; None where nothing measured it."""
    right_wrist: Float[np.ndarray, "3"] | None = None
    published_priming: str | None = None
    """``primed``, ``not_primed`` or ``excluded`` where the dataset itself says so."""
    published_prime_time: float | None = None
    hand_source: str | None = None
    """Source of the hand (:data:`prbench.recording.streams.HandSource`); None where it is unknown."""

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
    shortfalls: tuple[str, ...] = ()
    """One message for each stream that ends before the recording does; they stand in ``message``, too."""
    lacks: tuple[str, ...] = ()
    """Parts that it lacks to have events or sequences at all; stands in ``message``, too."""


@dataclass(frozen=True)
class SceneBox:
    """One row of ``scenes``: the box of a thing that stands still through a recording. World frame, metres."""

    recording_id: str
    object_id: str
    name: str
    category: str
    centre: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "4"]
    """World from box, quaternion w x y z."""
    half_extents: Float[np.ndarray, "3"]
    """Half the length of its edges."""
    entered: float | None
    """Largest depth to which a joint of the recorded person comes into it, over the whole recording; None without a
    body."""


def scene_batch(boxes: Iterable[SceneBox]) -> pa.RecordBatch:
    """Arrow rows of boxes, in the order given."""
    return row_batch(boxes, SCENES)


def sequence_batch(sequences: Iterable[Sequence]) -> pa.RecordBatch:
    """Arrow rows of sequences, in the order given."""
    return row_batch(sequences, SEQUENCES)


def event_batch(events: Iterable[EventRecord]) -> pa.RecordBatch:
    """Arrow rows of events, in the order given."""
    return row_batch(events, EVENTS)


def recording_batch(recordings: Iterable[RecordingRecord]) -> pa.RecordBatch:
    """Arrow rows of recordings, in the order given."""
    return row_batch(recordings, RECORDINGS, counted=OUTCOMES)
