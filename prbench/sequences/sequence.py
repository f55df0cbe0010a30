"""One sequence, one event, one recording, one box: what curation makes, what a row of a table holds, what Python shows.

The fields of these records are the columns of the tables, in their order (docs/table.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from prbench.sequences.chunk import row_batch, row_values
from prbench.sequences.columns import (
    Flags,
    Points,
    Pose,
    Poses,
    PrecisePoint,
    Quaternion,
    Rotations,
    Texts,
    Transform,
    schema_of,
)

FrameSource = Literal["recorded", "extrapolated", "copied"]
OUTCOMES = (
    "sequence",
    "no_location",
    "not_primed",
    "too_short",
    "minimum_movement",
    "no_body",
    "other_wearer",
    "excluded_category",
    "tracking_lost",
    "excluded_by_dataset",
    "not_published",
)
"""Possible outcomes of a candidate event."""


@dataclass(frozen=True, eq=False, repr=False)
class Sequence:
    """One prime-and-reach sequence: from 2 s before the first look at the goal until the object is picked or put.

    Positions are in the sequence's own canonical frame unless a name says ``world``: metres, Y up, the pelvis of the
    first frame over the origin facing +Z, the lowest joint of the sequence at Y = 0. Times are in seconds.
    """

    sequence_id: str
    """Dataset, recording, object, action, native time of the event and pose source, joined by slashes."""
    dataset: str
    """Name of the dataset; it begins with ``synthetic-`` where the people are synthetic."""
    recording_id: str
    """Name of the recording."""
    participant_id: str
    """Name of the person."""
    split: str
    """``train``, ``validation`` or ``test``."""
    split_group: str
    """Recordings of one group share the split."""
    action: str
    """``pick`` or ``put``; ``unknown`` only in an imported release."""
    object_id: str
    """The dataset's own id of the object."""
    object_name: str
    """The dataset's name of the object."""
    text: str
    """Sentence that a method conditioned on text is given."""
    hand: str | None
    """The hand that reaches, ``left`` or ``right``; None where nothing decides."""
    fps: float
    """Frames per second."""
    n_frames: int
    """Number of frames; the last one lies exactly on the event."""
    start_time: float
    """Time of the first frame, seconds on the recording's clock."""
    prime_time: float
    """Time of the first look at the goal, seconds on the recording's clock."""
    event_time: float
    """Time of the pick or put, seconds on the recording's clock."""
    prime_frame: int
    """The frame nearest to the prime time; metrics count from ``prime_after`` instead."""
    prime_gap: float
    """``event_time - prime_time``, seconds."""
    preroll: float
    """``prime_time - start_time``, seconds."""
    prime_kind: str
    """How gaze met the goal: ``hit`` or ``near_miss``; ``published`` or ``unknown`` where it was taken over."""
    prime_time_uncertainty: float
    """Spacing of the gaze samples around the prime time, seconds."""
    goal_location: PrecisePoint
    """Centre of the object's box at the event, metres."""
    goal_box_world_min: PrecisePoint
    """Lower end of that box along x, y and z of the world, metres."""
    goal_box_world_max: PrecisePoint
    """Upper end of that box along x, y and z of the world, metres."""
    body_movement: float
    """Largest distance of the pelvis from its first position, metres."""
    hand_movement: float
    """Largest displacement of the reaching wrist relative to the pelvis, metres."""
    pose_source: str
    """Where the body comes from."""
    head_tilt_deg: float
    """Rest tilt of the neck-head bone of the body's skeleton, degrees; Prime Success needs it."""
    joints: Poses
    """Positions (n, 22, 3) of the 22 joints (:class:`prbench.Joint`) in every frame, metres."""
    previous_joints: Pose
    """The pose (22, 3) one frame before the first, metres."""
    previous_source: FrameSource
    """How the pose before was got: ``recorded``, ``extrapolated`` or ``copied``."""
    next_joints: Pose
    """The pose (22, 3) one frame after the last, metres."""
    next_source: FrameSource
    """How the pose after was got: ``recorded``, ``extrapolated`` or ``copied``."""
    head_position: Points | None
    """Position (n, 3) of the glasses in every frame, between the eyes, metres; None where unknown."""
    head_rotation: Rotations | None
    """Rotation (n, 4) from the glasses (x left, y up, z forward), quaternions w x y z; None where unknown."""
    gaze_origin: Points
    """Start (n, 3) of each gaze ray, between the eyes, metres."""
    gaze_direction: Points
    """Direction (n, 3) of each gaze ray, unit vectors."""
    gaze_valid: Flags
    """False (n,) where the eye tracker had no measurement; the ray then says nothing."""
    world_from_canonical: Transform
    """Rigid transform (4, 4) from the canonical frame to the recording's world (Y up), metres."""
    extra: Texts = field(default_factory=dict)
    """What only this dataset has, by name."""

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Time of each frame, seconds after the first frame."""
        return np.arange(self.n_frames) / self.fps

    @property
    def prime_after(self) -> float:
        """Time of the first look at the goal, seconds after the first frame; what :func:`prbench.measure` takes."""
        return self.prime_time - self.start_time

    def __repr__(self) -> str:
        hand = f", {self.hand} hand" if self.hand else ""
        return (
            f"<Sequence {self.sequence_id}: {self.action} of {self.object_name}{hand},"
            f" {self.n_frames} frames at {self.fps:g} Hz, {self.split}>"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Event:
    """One candidate event, an object picked or put, and what became of it; world frame, metres, seconds."""

    event_id: str
    """Dataset, recording, object, action and native time, joined by slashes."""
    recording_id: str
    """Name of the recording."""
    sequence_id: str | None
    """Id of the sequence that the event became; None if it was dropped."""
    object_id: str
    """The dataset's own id of the object."""
    object_name: str
    """The dataset's name of the object."""
    action: str
    """``pick`` or ``put``."""
    hand: str | None
    """The hand that reaches, ``left`` or ``right``; None where nothing decides."""
    event_time: float
    """Time of the pick or put, seconds on the recording's clock."""
    prime_time: float | None
    """Time of the first look at the object's place, seconds on the recording's clock; None if there was none."""
    prime_kind: str | None
    """How gaze met the place: ``hit``, ``near_miss`` or ``published``; None if it did not."""
    location: PrecisePoint | None
    """Centre (3,) of the object's box; None where the object could not be placed."""
    box_min: PrecisePoint | None
    """Lower end (3,) of the object's box along x, y and z; None where the object could not be placed."""
    box_max: PrecisePoint | None
    """Upper end (3,) of the object's box along x, y and z; None where the object could not be placed."""
    outcome: str
    """``sequence`` if it became one, else why not (docs/table.md#events)."""
    stage: str
    """The stage of curation that decided."""
    value: float | None
    """The number that decided."""
    threshold: float | None
    """What the number was compared with."""
    left_wrist: PrecisePoint | None = None
    """The left wrist (3,) at the event; None where nothing measured it."""
    right_wrist: PrecisePoint | None = None
    """The right wrist (3,) at the event; None where nothing measured it."""
    published_priming: str | None = None
    """``primed``, ``not_primed`` or ``excluded`` where the dataset publishes priming of its own; else None."""
    published_prime_time: float | None = None
    """The prime time that the dataset publishes, seconds on the recording's clock; None where it publishes none."""
    hand_source: str | None = None
    """What told the hand (docs/table.md#which-hand-reached); None where the hand is unknown."""

    def __repr__(self) -> str:
        return f"<Event {self.event_id}: {self.action} of {self.object_name}, {self.outcome}>"


@dataclass(frozen=True)
class Recording:
    """One recording that a build found."""

    recording_id: str
    """Name of the recording."""
    participant_id: str
    """Name of the person."""
    split: str
    """``train``, ``validation`` or ``test``."""
    split_group: str
    """Recordings of one group share the split."""
    duration: float
    """Length of the part with ground truth, seconds."""
    outcomes: Mapping[str, int]
    """Number of its candidate events by outcome."""
    status: str
    """``read``, ``failed`` or ``skipped``."""
    message: str
    """Why it was not read, or what was noticed when it was."""
    shortfalls: tuple[str, ...] = field(default=(), repr=False)
    """One message for each stream that ends before the recording does; they stand in ``message``, too."""
    lacks: tuple[str, ...] = field(default=(), repr=False)
    """Parts that it lacks to have events or sequences at all; stands in ``message``, too."""

    @property
    def why_fruitless(self) -> str:
        """The outcomes of its events, the most frequent first, and what it lacks: why it gave no sequence."""
        outcomes = sorted(self.outcomes.items(), key=lambda item: (-item[1], item[0]))
        became = ", ".join(f"{number} {outcome}" for outcome, number in outcomes if number)
        events = f"of {sum(self.outcomes.values())} events {became}" if became else "no candidate event"
        return "; ".join((events, *self.lacks))


@dataclass(frozen=True, eq=False)
class SceneBox:
    """The box of a thing that stands still through a recording. World frame, metres."""

    recording_id: str
    object_id: str
    name: str
    category: str
    centre: PrecisePoint
    rotation: Quaternion
    """World from box, quaternion w x y z."""
    half_extents: PrecisePoint
    """Half the length of its edges."""
    entered: float | None
    """Largest depth to which a joint of the recorded person comes into it, over the whole recording; None without a
    body."""


SEQUENCES = schema_of(Sequence)
EVENTS = schema_of(Event)
RECORDINGS = schema_of(Recording, counted=OUTCOMES, without=("shortfalls", "lacks"))
SCENES = schema_of(SceneBox)


def sequence_batch(sequences: Iterable[Sequence]) -> pa.RecordBatch:
    """Return Arrow rows of sequences, in the order given."""
    return row_batch(sequences, SEQUENCES)


def event_batch(events: Iterable[Event]) -> pa.RecordBatch:
    """Return Arrow rows of events, in the order given."""
    events = list(events)
    assert all(event.outcome in OUTCOMES for event in events), "curation has no other outcomes"
    return row_batch(events, EVENTS)


def recording_batch(recordings: Iterable[Recording]) -> pa.RecordBatch:
    """Return Arrow rows of recordings, in the order given."""
    return row_batch(recordings, RECORDINGS, counted=OUTCOMES)


def scene_batch(boxes: Iterable[SceneBox]) -> pa.RecordBatch:
    """Return Arrow rows of boxes, in the order given."""
    return row_batch(boxes, SCENES)


def sequences_in(batch: pa.RecordBatch) -> Iterator[Sequence]:
    """Yield the sequences of rows with all columns; their arrays are views of the rows."""
    columns = [row_values(batch.column(name)) for name in SEQUENCES.names]
    return (Sequence(*values) for values in zip(*columns, strict=True))


def event_of(events: pa.Table, row: int) -> Event:
    """Return the event in one row of ``events``."""
    batch = events.slice(row, 1).combine_chunks().to_batches()[0]
    return Event(**{name: row_values(batch.column(name))[0] for name in EVENTS.names})


def recording_of(recordings: pa.Table, row: int) -> Recording:
    """Return the recording in one row of ``recordings``."""
    (values,) = recordings.slice(row, 1).select(RECORDINGS.names).to_pylist()
    outcomes = {name: values.pop(name) for name in OUTCOMES}
    return Recording(**values, outcomes=outcomes)
