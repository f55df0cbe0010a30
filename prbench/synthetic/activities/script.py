"""The form of a script: every movement command of one recording, in time order, and which activity it serves.

Times in seconds of the recording, metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.base import BasePose, Segment
from prbench.synthetic.people.gaze_plan import Look
from prbench.synthetic.people.person import Person

Place = Literal["rest", "shoulder", "world", "thigh", "head", "middle"]
"""What a hand's target is fixed to; ``middle`` is the point between the shoulders."""


@dataclass(frozen=True)
class Arc:
    """Walking along a part of a circle."""

    start: BasePose
    begin: float
    end: float
    length: float
    turn: float
    """Change of heading; > 0 to the left."""
    segment: Segment
    """The same for the planner of steps."""

    @property
    def goal(self) -> BasePose:
        """Where it ends."""
        x, z, heading = self.at(np.array([1.0]))
        return BasePose(float(x[0]), float(z[0]), float(heading[0]))

    def at(self, progress: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, z and heading after a share of the way."""
        radius, first = self.length / self.turn, self.start.heading
        heading = first + progress * self.turn
        x = self.start.x + radius * (np.cos(first) - np.cos(heading))
        z = self.start.z + radius * (np.sin(heading) - np.sin(first))
        return x, z, heading


Move = Segment | Arc


@dataclass(frozen=True)
class Bend:
    """Lean and crouch (share of the leg) taken up within ``duration``."""

    begin: float
    duration: float
    lean: float
    crouch: float
    chest_turn: float = 0.0


@dataclass(frozen=True)
class Sit:
    """Sitting down, or standing up."""

    begin: float
    duration: float
    down: bool


@dataclass(frozen=True)
class Loop:
    """An ellipse around a hand's target."""

    begin: float
    end: float
    first: Float[np.ndarray, "3"]
    """Half axis, chest frame, metres."""
    second: Float[np.ndarray, "3"]
    frequency: float
    """Hz."""


@dataclass(frozen=True)
class Hand:
    """A hand takes up a target within ``duration``."""

    hand: int
    """0 left, 1 right."""
    begin: float
    duration: float
    place: Place
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Outwards, up, forward; fractions of the stature (``world``: a point, metres)."""
    loop: Loop | None = None
    pole: tuple[float, float, float] | None = None
    """Where the elbow points (outwards, up, forward of the chest); None: as arms do."""
    bulge: float = 0.0
    """How far the path swings forward on the way, metres: not through the own shoulder."""


@dataclass(frozen=True)
class Act:
    """One activity that was planned; its words are chosen from what then happens."""

    name: str
    begin: float
    end: float
    hand: int | None = None


@dataclass
class Script:
    """All commands of one recording; filled by the activities, one after the other."""

    person: Person
    start: BasePose
    moves: list[Move] = field(default_factory=list)
    bends: list[Bend] = field(default_factory=list)
    sits: list[Sit] = field(default_factory=list)
    hands: list[Hand] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)
    acts: list[Act] = field(default_factory=list)
    end: float = 0.0

    @property
    def segments(self) -> tuple[Segment, ...]:
        """All changes of place, as the planner of steps takes them."""
        return tuple(move.segment if isinstance(move, Arc) else move for move in self.moves)
