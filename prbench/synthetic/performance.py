"""One procedural recording with everything known: what the people act out, before any sensor sees it.

Frames: metres, Y up, right-handed, floor at y = 0; seconds from the start of the recording; quaternions w x y z,
segment to world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

Side = Literal["left", "right"]


@dataclass(frozen=True)
class PersonStyle:
    """Who acts: body size and habits (docs/specification/synthetic-recordings.md#person).

    Attributes:
        parameters: Every drawn factor by name, for the truth record.
    """

    participant_id: str
    stature: float
    neck_tilt_deg: float
    preferred_hand: Side
    parameters: dict[str, float]


@dataclass(frozen=True)
class ObjectMotion:
    """One object: its box and where it is at every frame. At rest the pose is bit-constant.

    Attributes:
        position: Centre of the box; ``(1, 3)`` for an object that never moves.
        held_by: -1 nobody, 0 left hand, 1 right hand of the wearer, 2 somebody else.
        movable: Whether a tracking system would follow it ("dynamic"), not whether it moves here.
    """

    object_id: str
    name: str
    category: str
    half_extents: Float[np.ndarray, "3"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    held_by: Int[np.ndarray, " n"]
    movable: bool
    hinged: bool = False


@dataclass(frozen=True)
class TrueEvent:
    """One pick or put, or one provocation, with its exact instants.

    Sources: docs/specification/synthetic-recordings.md#event-truth and
    docs/specification/synthetic-recordings.md#truth-record.

    Attributes:
        tag: ``plain``, ``near``, ``unprimed`` or a provocation
            (docs/specification/synthetic-recordings.md#provocations).
        prime_time: First instant of noise-free gaze that hits or nearly misses for at least 50 ms; None if there is
            none.
        prime_first: First instant of any hit or near miss, however short.
        expected: The outcome that curation should reach: one of the outcomes of ``events``, or ``not_an_event``.
        thin: Too close to a threshold to assert on.
        lost_span: Provocation ``lost``: when tracking must lose the object, seconds; the sensors drop its samples
            there.
    """

    event_id: str
    action: Literal["pick", "put"]
    tag: str
    object_id: str
    object_name: str
    hand: Side
    contact_time: float
    event_time: float
    release_time: float
    goal: Float[np.ndarray, "3"]
    box_min: Float[np.ndarray, "3"]
    box_max: Float[np.ndarray, "3"]
    prime_planned: float | None
    prime_time: float | None
    prime_first: float | None
    prime_kind: Literal["hit", "near_miss"] | None
    motor_start: float
    reach_start: float
    expected: str
    thin: bool
    lost_span: tuple[float, float] | None = None


@dataclass(frozen=True)
class Fixation:
    """One planned look."""

    start: float
    end: float
    target: Float[np.ndarray, "3"]
    kind: Literal["goal", "fill"]
    event_id: str | None


@dataclass(frozen=True)
class OtherPerson:
    """A second person in the scene (provocation ``bystander``), who carries no sensors that prbench reads."""

    participant_id: str
    joints: Float[np.ndarray, "n 22 3"]
    finger_bases: Float[np.ndarray, "n 2 3"]


@dataclass(frozen=True)
class Performance:
    """One recording of one procedural person, noise-free, on a uniform grid (120 Hz unless asked otherwise).

    Attributes:
        rotations: World from the segment that begins at each joint. Pelvis, spine, neck, head (the true one), collars
            (chest) and feet: x left, y up, z forward. Limbs and hands: y along the bone, away from the trunk, x the
            hinge (left at neutral).
        finger_bases: Middle-finger bases: left, right.
        head_rotation: The true head (and glasses) orientation: x left, y up, z forward.
        eye: Central pupil frame origin.
        gaze: Unit gaze direction, world frame, noise-free.
        planted: Whether the ball of the left, right foot is at rest.
    """

    preset: str
    world: Literal["default", "large"]
    seed: int
    index: int
    recording_id: str
    room_id: str
    split: Literal["train", "validation", "test"]
    person: PersonStyle
    rate: float
    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    rotations: Float[np.ndarray, "n 22 4"]
    finger_bases: Float[np.ndarray, "n 2 3"]
    head_rotation: Float[np.ndarray, "n 4"]
    eye: Float[np.ndarray, "n 3"]
    gaze: Float[np.ndarray, "n 3"]
    planted: Bool[np.ndarray, "n 2"]
    objects: tuple[ObjectMotion, ...]
    events: tuple[TrueEvent, ...]
    fixations: tuple[Fixation, ...]
    other_people: tuple[OtherPerson, ...] = ()

    @property
    def duration(self) -> float:
        """Seconds from first to last frame."""
        return float(self.times[-1] - self.times[0])
