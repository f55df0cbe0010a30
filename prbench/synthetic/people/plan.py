"""The form of a plan: every decision about body and objects of one recording.

Sources: docs/specification/synthetic-recordings.md#world, docs/specification/synthetic-recordings.md#base-motion,
docs/specification/synthetic-recordings.md#reaching-and-holding, docs/specification/synthetic-recordings.md#event-truth
and docs/specification/synthetic-recordings.md#provocations. Made by :mod:`planner`; the gaze is planned in
:mod:`gaze_plan`, the motion follows without further choices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.base import BasePose, Segment
from prbench.synthetic.people.grasp import Grasp, Posture
from prbench.synthetic.people.person import Person, seated_pelvis_height
from prbench.synthetic.people.presets import Preset
from prbench.synthetic.people.world import Item, Room

OPENING = 2.5
"""Seconds of standing before anything happens."""

Action = Literal["pick", "put", "hover", "pass_by", "touch", "nudge", "hinge"]


@dataclass(frozen=True)
class ReachChange:
    """Changes that a provocation makes to one reach; the default changes nothing.

    Source: docs/specification/synthetic-recordings.md#provocations.
    """

    gap: float | None = None
    """Forced time from the first look to the event."""
    second_hand: float = 0.0
    """Distance at which the other hand joins, metres; 0: it does not."""
    handed_over: float | None = None
    """Of a put: when the object began to change hands."""
    slide: Float[np.ndarray, "3"] | None = None
    """How far a nudged object slides."""
    opening: float = 0.0
    """Angle by which a hinged object is turned, radians."""
    lost: tuple[float, float] | None = None
    """Span in which tracking loses the object."""


@dataclass(frozen=True)
class Reach:
    """One purposeful movement of a hand: a pick, a put, or a movement that is neither."""

    number: int
    action: Action
    tag: str
    """``plain`` or a provocation."""
    item: int
    """Index of the object."""
    hand: int
    surface: int
    centre: Float[np.ndarray, "3"]
    """Centre of the object's box at rest: before a pick, after a put."""
    yaw: float
    half_world: Float[np.ndarray, "3"]
    base: BasePose
    grasp: Grasp
    posture: Posture
    motor_start: float
    reach_start: float
    contact: float
    """The wrist is at its target."""
    event: float
    """Planned event time; the object starts or stops moving about then."""
    dwell: float
    """Seconds that the hand stays after the event, unless it carries the object away."""
    carries: bool
    twist: ReachChange = ReachChange()


@dataclass(frozen=True)
class Plan:
    """All decisions about body and objects of one recording."""

    preset: Preset
    person: Person
    room: Room
    is_seated: bool
    start: BasePose
    items: tuple[Item, ...]
    """Objects that are handled, then those of the room that never move."""
    segments: tuple[Segment, ...]
    reaches: tuple[Reach, ...]

    @property
    def pelvis_height(self) -> float | None:
        """Height of a seated person's pelvis; None when standing."""
        return seated_pelvis_height(self.person.body) if self.is_seated else None
