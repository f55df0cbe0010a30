"""The script of a recording: commands of the activities, and the writer who knows where the person is between them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.base import BasePose, Segment, plan_segment
from prbench.synthetic.people.gaze_plan import Look
from prbench.synthetic.people.grasp import solve_posture
from prbench.synthetic.people.kinematics import direction
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
        """Place where the activity ends."""
        x, z, heading = self.at(np.array([1.0]))
        return BasePose(float(x[0]), float(z[0]), float(heading[0]))

    def at(self, progress: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, z and heading after a share of the way."""
        radius = self.length / self.turn
        first = self.start.heading
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


SITTING_TIME = 1.6
_EYE_HEIGHT = 0.93  # of the stature
_SEATED_EYE_HEIGHT = 0.71
_ARC_START = 0.5  # s
_ARC_STOP = 0.65


class ScriptWriter:
    """Adds movements to a script; knows where the person is and whether they sit."""

    def __init__(self, person: Person, rng: np.random.Generator) -> None:
        self.person = person
        self.rng = rng
        self.base = BasePose(0.0, 0.0, float(rng.uniform(-np.pi, np.pi)))
        self.script = Script(person, self.base)
        self.now = 0.0
        self.is_seated = False

    @property
    def stature(self) -> float:
        """Height of the person, metres."""
        return self.person.body.stature

    def draw(self, low: float, high: float) -> float:
        """Draw a uniform number."""
        return float(self.rng.uniform(low, high))

    def side(self) -> int:
        """Draw +1 (left) or -1 (right), equally often."""
        return 1 if self.rng.random() < 0.5 else -1

    def free_hand(self) -> int:
        """Draw a hand: the preferred one three times in four."""
        right = bool(self.person.habits.right_handed) is (self.rng.random() < 0.75)
        return int(right)

    def did(self, name: str, begin: float, end: float, hand: int | None = None) -> None:
        """Record that an activity is planned; the next begins after it."""
        self.script.acts.append(Act(name, begin, end, hand))
        self.now = end
        self.script.end = end

    def pace(self, speed: float, distance: float) -> float:
        """Return the factor on this person's usual speed at which a way of that length is walked that fast."""
        return speed / (self.person.habits.walk_speed * float(1.0 - np.exp(-(distance + 0.15) / 0.75)))

    def go(self, goal: BasePose, pace: float) -> Segment | None:
        """Walk to a place, or shuffle there without turning into the way."""
        segment = plan_segment(self.person.habits, pace, self.base, goal, self.now, faces_on=True)
        if segment is not None:
            self.script.moves.append(segment)
            self.base = segment.goal
        return segment

    def ahead(self, distance: float, heading: float) -> BasePose:
        """Return a place in some direction, facing that way."""
        return BasePose(
            self.base.x + distance * float(np.sin(heading)), self.base.z + distance * float(np.cos(heading)), heading
        )

    def curve(self, length: float, turn: float, pace: float) -> Arc:
        """Walk along an arc."""
        speed = self.person.habits.walk_speed * pace * (1.0 - np.exp(-(length + 0.15) / 0.75))
        end = self.now + length / speed + 0.5 * (_ARC_START + _ARC_STOP)
        start = self.base
        heading = self.base.heading
        plain = Segment("walk", start, start, self.now, end, end, float(speed), heading, 0.0, 0.0, self.now)
        goal = Arc(start, self.now, end, length, turn, plain).goal
        segment = Segment("walk", start, goal, self.now, end, end, float(speed), heading, 0.0, 0.0, self.now)
        arc = Arc(start, self.now, end, length, turn, segment)
        self.script.moves.append(arc)
        self.base = arc.goal
        return arc

    def bend(self, at: float, duration: float, lean: float, crouch: float, chest_turn: float = 0.0) -> None:
        """Lean and crouch."""
        self.script.bends.append(Bend(at, duration, lean, crouch, chest_turn))

    def sit(self, *, down: bool) -> None:
        """Sit down or stand up, hands on the thighs or hanging again."""
        self.script.sits.append(Sit(self.now, SITTING_TIME, down))
        self.is_seated = down
        for hand in (0, 1):
            self.rest(hand, self.now + (0.3 if down else 0.1), 1.2)

    def move_hand(
        self,
        hand: int,
        at: float,
        duration: float,
        place: Place,
        offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        bulge: float = 0.0,
    ) -> None:
        """Bring a hand somewhere, on a path that bulges forward."""
        self.script.hands.append(Hand(hand, at, duration, place, offset, bulge=bulge))

    def rest(self, hand: int, at: float, duration: float, *, bulge: float = 0.0) -> None:
        """Bring a hand back to where it waits."""
        self.move_hand(hand, at, duration, "thigh" if self.is_seated else "rest", bulge=bulge)

    def look(self, begin: float, end: float, yaw: float, pitch: float, distance: float = 2.5) -> None:
        """Look somewhere relative to the heading; yaw > 0 left, pitch > 0 down."""
        if self.script.looks and begin < self.script.looks[-1].end:
            begin = self.script.looks[-1].end
        if end - begin < 0.15:
            return
        point = self.eye + distance * direction(self.base.heading + yaw, pitch)
        self.script.looks.append(Look(begin, end, point, True, None))

    def look_at(self, begin: float, end: float, point: np.ndarray) -> None:
        """Look at a point of the world."""
        if self.script.looks and begin < self.script.looks[-1].end:
            begin = self.script.looks[-1].end
        if end - begin >= 0.15:
            self.script.looks.append(Look(begin, end, point, True, None))

    @property
    def eye(self) -> np.ndarray:
        """About where the eyes are."""
        point = self.base.point - (0.22 * self.stature * self.base.forward if self.is_seated else 0.0)
        return point + np.array([0.0, self.stature * (_SEATED_EYE_HEIGHT if self.is_seated else _EYE_HEIGHT), 0.0])

    def before_chest(self, up: float, forward: float, left: float = 0.0) -> np.ndarray:
        """Return a point of the world before the person; fractions of the stature, ``up`` from the eyes."""
        return self.eye + self.stature * (
            up * np.array([0.0, 1.0, 0.0]) + forward * self.base.forward + left * self.base.left
        )

    def reach(self, hand: int, wrist: np.ndarray, begin: float, duration: float, stay: float) -> float:
        """Bring a wrist to a point of the world and back, bending as far as needed; returns when the hand is back."""
        posture = solve_posture(self.person, self.base, hand, wrist)
        if not self.is_seated:
            self.bend(begin, duration - 0.1, posture.lean, posture.crouch, posture.chest_turn)
            self.bend(begin + duration + stay, 0.8 + 1.25 * posture.crouch, 0.0, 0.0)
        self.move_hand(hand, begin + 0.1, duration - 0.1, "world", (float(wrist[0]), float(wrist[1]), float(wrist[2])))
        self.rest(hand, begin + duration + stay, 0.9)
        self.look_at(begin - 0.2, begin + duration + stay, wrist)
        return begin + duration + stay + 0.9 + 0.6 * posture.crouch
