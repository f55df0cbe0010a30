"""One procedural recording with everything known: what the people act out, before any sensor sees it.

Frames: metres, Y up, right-handed, floor at y = 0; seconds from the start of the recording; quaternions w x y z,
segment to world.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.recording import Side

World = Literal["default", "large", "second"]
Progress = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class Body:
    """Bone offsets in metres; sideways parts are given for the left and mirrored for the right.

    Attributes:
        ankle_height: Ankle above the ball of the flat foot.
        foot_length: Ankle to ball, forward.
        spine: Pelvis to spine1, spine1 to spine2, spine2 to spine3, spine3 to neck.
        neck_tilt: Radians.
        hand: Wrist to middle-finger base.
        eye: Head joint to eyes in the head's frame.
    """

    stature: float
    hip: tuple[float, float, float]
    thigh: float
    shin: float
    ankle_height: float
    foot_length: float
    spine: tuple[tuple[float, float, float], ...]
    neck_length: float
    neck_tilt: float
    collar: tuple[float, float, float]
    shoulder: tuple[float, float, float]
    upper_arm: float
    forearm: float
    hand: float
    eye: tuple[float, float, float]

    @property
    def leg(self) -> float:
        """Thigh plus shin."""
        return self.thigh + self.shin

    @property
    def arm(self) -> float:
        """Upper arm plus forearm."""
        return self.upper_arm + self.forearm


@dataclass(frozen=True)
class Habits:
    """Habits of movement of one person. Radians, seconds, metres.

    Attributes:
        walk_ratio: Metres per (step a minute).
        turn_rate: Radians per second, mean over a turn.
    """

    walk_speed: float
    walk_ratio: float
    half_stance: float
    toe_out: float
    arm_swing: float
    stoop: float
    elbow_flare: float
    goal_gain: float
    fill_gain: float
    goal_gain_vertical: float
    fill_gain_vertical: float
    eye_only_range: float
    head_lag: float
    neck_share: float
    chest_share: float
    pelvis_share: float
    trunk_time: float
    reach_time: float
    turn_rate: float
    right_handed: float
    toe_clearance: float


@dataclass(frozen=True)
class Manner:
    """Laws of movement that all people of a world share. Progress functions take shares of time to shares of way.

    Attributes:
        reach: Progress of a hand.
        turn_head: Progress of a turn of the head.
        head_turn: Seconds of a turn of the head of no size, and seconds a degree.
        swing_foot: Progress of a swinging foot.
        reach_time: Seconds of a reach of no length, and seconds a metre.
        hump: How far the way of a hand bulges up and forward, metres.
        bends: Crouch (share of the leg) and lean (radians) that are equally disliked.
        even_steps: Whether steps are even in length and not in time.
    """

    reach: Progress
    turn_head: Progress
    head_turn: tuple[float, float]
    swing_foot: Progress
    reach_time: tuple[float, float]
    hump: tuple[float, float]
    bends: tuple[float, float]
    even_steps: bool


@dataclass(frozen=True)
class Person:
    """A body and its habits."""

    participant_id: str
    body: Body
    habits: Habits
    manner: Manner

    @property
    def neck_tilt_deg(self) -> float:
        """Rest tilt of the neck-head bone, degrees."""
        return float(np.rad2deg(self.body.neck_tilt))

    @property
    def style(self) -> dict[str, float]:
        """Every drawn factor by name, for the truth record."""
        lengths = {name: getattr(self.body, name) for name in ("thigh", "shin", "upper_arm", "forearm")}
        return {name: float(value) for name, value in asdict(self.habits).items()} | lengths


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
    world: World
    seed: int
    index: int
    recording_id: str
    room_id: str
    split: Literal["train", "validation", "test"]
    person: Person
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
