"""The script of a recording: commands of the activities, and the writer who knows where the person is between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.gaze_plan import Look
from prbench.synthetic.people.kinematics import direction
from prbench.synthetic.people.person import Person
from prbench.synthetic.people.reaching import Reacher, solve_posture
from prbench.synthetic.people.walking import BasePose, Segment, plan_segment

# What a hand's target is fixed to; ``middle`` is the point between the shoulders.
Place = Literal["rest", "shoulder", "world", "thigh", "head", "middle"]


@dataclass(frozen=True)
class Arc:
    """Walking along a part of a circle.

    Attributes:
        turn: Change of heading; > 0 to the left.
        segment: The same for the planner of steps.
    """

    start: BasePose
    begin: float
    end: float
    length: float
    turn: float
    segment: Segment

    def at(self, progress: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, z and heading after a share of the way."""
        radius = self.length / self.turn
        first = self.start.heading
        heading = first + progress * self.turn
        x = self.start.x + radius * (np.cos(first) - np.cos(heading))
        z = self.start.z + radius * (np.sin(heading) - np.sin(first))
        return x, z, heading


@dataclass(frozen=True)
class Loop:
    """An ellipse around a hand's target.

    Attributes:
        first: Half axis, chest frame, metres.
        frequency: Hz.
    """

    begin: float
    end: float
    first: Float[np.ndarray, "3"]
    second: Float[np.ndarray, "3"]
    frequency: float


@dataclass(frozen=True)
class Hand:
    """A hand takes up a target within ``duration``.

    Attributes:
        hand: 0 left, 1 right.
        offset: Outwards, up, forward; fractions of the stature (``world``: a point, metres).
        pole: Direction in which the elbow points (outwards, up, forward of the chest); None: as arms do.
        bulge: How far the path swings forward on the way, metres: not through the own shoulder.
    """

    hand: int
    begin: float
    duration: float
    place: Place
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    loop: Loop | None = None
    pole: tuple[float, float, float] | None = None
    bulge: float = 0.0


@dataclass(frozen=True)
class Act:
    """One activity that was planned; its words are chosen from what then happens."""

    name: str
    begin: float
    end: float
    hand: int | None = None


@dataclass
class Script:
    """All commands of one recording; filled by the activities, one after the other.

    Attributes:
        bends: Begin and duration of each, and the lean, crouch (share of the leg) and turn of the chest that are taken
            up.
        sits: Begin of each, and whether the person sits down or stands up.
    """

    person: Person
    start: BasePose
    moves: list[Segment | Arc] = field(default_factory=list)
    bends: list[tuple[float, float, tuple[float, float, float]]] = field(default_factory=list)
    sits: list[tuple[float, bool]] = field(default_factory=list)
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
ARC_START = 0.5  # s
ARC_STOP = 0.65


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
        return int(bool(self.person.habits.right_handed) is (self.rng.random() < 0.75))

    def did(self, name: str, end: float, hand: int | None = None) -> None:
        """Record that an activity is planned from now on; the next begins after it."""
        self.script.acts.append(Act(name, self.now, end, hand))
        self.now = end
        self.script.end = end

    def pace(self, speed: float, distance: float) -> float:
        """Return the factor on this person's usual speed at which a way of that length is walked that fast."""
        return speed / (self.person.habits.walk_speed * float(1.0 - np.exp(-(distance + 0.15) / 0.75)))

    def go(self, goal: BasePose, pace: float, otherwise: float) -> float:
        """Walk to a place, or shuffle there; returns when, in ``otherwise`` seconds where the feet may stay."""
        segment = plan_segment(self.person.habits, pace, self.base, goal, self.now, faces_on=True)
        if segment is None:
            return self.now + otherwise
        self.script.moves.append(segment)
        self.base = segment.goal
        return segment.end

    def ahead(self, distance: float, heading: float) -> BasePose:
        """Return a place in some direction, facing that way."""
        x = self.base.x + distance * float(np.sin(heading))
        return BasePose(x, self.base.z + distance * float(np.cos(heading)), heading)

    def curve(self, length: float, turn: float, pace: float) -> Arc:
        """Walk along an arc."""
        speed = self.person.habits.walk_speed * pace * (1.0 - np.exp(-(length + 0.15) / 0.75))
        end = self.now + length / speed + 0.5 * (ARC_START + ARC_STOP)
        start = self.base
        plain = Segment("walk", start, start, self.now, end, end, float(speed), start.heading, 0.0, 0.0, self.now)
        x, z, heading = Arc(start, self.now, end, length, turn, plain).at(np.array([1.0]))
        self.base = BasePose(float(x[0]), float(z[0]), float(heading[0]))
        arc = Arc(start, self.now, end, length, turn, replace(plain, goal=self.base))
        self.script.moves.append(arc)
        return arc

    def bend(self, at: float, duration: float, lean: float, crouch: float, chest_turn: float = 0.0) -> None:
        """Lean and crouch."""
        self.script.bends.append((at, duration, (lean, crouch, chest_turn)))

    def sit(self, *, down: bool) -> None:
        """Sit down or stand up, hands on the thighs or hanging again."""
        self.script.sits.append((self.now, down))
        self.is_seated = down
        for hand in (0, 1):
            self.rest(hand, self.now + (0.3 if down else 0.1), 1.2)

    def rest(self, hand: int, at: float, duration: float, *, bulge: float = 0.0) -> None:
        """Bring a hand back to where it waits."""
        self.script.hands.append(Hand(hand, at, duration, "thigh" if self.is_seated else "rest", bulge=bulge))

    def look(self, begin: float, end: float, yaw: float, pitch: float, distance: float = 2.5) -> None:
        """Look somewhere relative to the heading; yaw > 0 left, pitch > 0 down."""
        self.look_at(begin, end, self.eye + distance * direction(self.base.heading + yaw, pitch))

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
        offset = up * np.array([0.0, 1.0, 0.0]) + forward * self.base.forward + left * self.base.left
        return self.eye + self.stature * offset

    def reach(self, hand: int, wrist: np.ndarray, begin: float, duration: float, stay: float) -> float:
        """Bring a wrist to a point of the world and back, bending as far as needed; returns when the hand is back."""
        posture = solve_posture(Reacher(self.person, self.base, hand), wrist)
        if not self.is_seated:
            self.bend(begin, duration - 0.1, posture.lean, posture.crouch, posture.chest_turn)
            self.bend(begin + duration + stay, 0.8 + 1.25 * posture.crouch, 0.0, 0.0)
        x, y, z = wrist.tolist()
        self.script.hands.append(Hand(hand, begin + 0.1, duration - 0.1, "world", (x, y, z)))
        self.rest(hand, begin + duration + stay, 0.9)
        self.look_at(begin - 0.2, begin + duration + stay, wrist)
        return begin + duration + stay + 0.9 + 0.6 * posture.crouch


# Slow, normal (twice as often) and brisk walking, metres a second; nobody turns a corner briskly.
_SPEEDS = ((0.5, 0.65), (0.8, 1.1), (0.8, 1.1), (1.28, 1.32))
_CARRY = (-0.05, -0.17, 0.19)
_CARRY_BOTH = (-0.015, -0.17, 0.19)
_NO_CORNER = 0.1  # rad
_BULGE = 0.22  # m
_WAVING_ELBOW = (1.0, -0.8, 0.0)


def _walk(writer: ScriptWriter, *, least: float, most: float, side: float) -> None:
    """Turn by an angle between these, radians, and walk: slowly, normally or briskly."""
    turn = side * writer.draw(least, most)
    speeds = _SPEEDS if abs(turn) < _NO_CORNER else _SPEEDS[:-1]
    speed = writer.draw(*speeds[int(writer.rng.integers(len(speeds)))])
    distance = speed * writer.draw(2.4, 3.0)
    end = writer.go(writer.ahead(distance, writer.base.heading + turn), writer.pace(speed, distance), 3.0)
    writer.did("walk", end)


def _walk_curve(writer: ScriptWriter) -> None:
    """Walk along an arc."""
    length = writer.draw(2.4, 3.6)
    arc = writer.curve(length, writer.side() * writer.draw(0.8, 1.6), writer.pace(writer.draw(0.8, 1.05), length))
    writer.did("curve", arc.end)


def _walk_carrying(writer: ScriptWriter) -> None:
    """Walk with one or both hands held before the chest, as with something in them."""
    begin = writer.now
    hand = int(writer.rng.integers(3))
    hands = (0, 1) if hand == 2 else (hand,)
    for one in hands:
        writer.script.hands.append(Hand(one, begin, 0.75, "shoulder", _CARRY_BOTH if hand == 2 else _CARRY))
    writer.now += 0.5
    goal = writer.ahead(writer.draw(1.8, 2.6), writer.base.heading + writer.draw(-0.2, 0.2))
    end = writer.go(goal, writer.draw(0.8, 1.0), 3.0)
    for one in hands:
        writer.rest(one, end - 0.1, 0.9)
    writer.now = begin
    writer.did("carry", end + 0.3, hand)


def _turn_around(writer: ScriptWriter) -> None:
    """Turn on the spot."""
    angle = writer.side() * writer.draw(0.55, 3.0)
    writer.look(writer.now - 0.1, writer.now + 0.9, float(np.clip(angle, -1.4, 1.4)), 0.1)
    writer.did("turn", writer.go(replace(writer.base, heading=writer.base.heading + angle), 1.0, 1.5))


def stand(writer: ScriptWriter) -> None:
    """Stand, or sit, without doing anything."""
    writer.did("sit" if writer.is_seated else "stand", writer.now + writer.draw(2.2, 3.4))


def look_around(writer: ScriptWriter) -> None:
    """Look far to both sides in turn."""
    time = writer.now
    side = writer.side()
    for _ in range(int(writer.rng.integers(3, 5))):
        length = writer.draw(0.75, 1.15)
        writer.look(time, time + length, side * writer.draw(0.7, 1.35), writer.draw(-0.15, 0.3))
        time = time + length
        side = -side
    writer.did("look around", time)


def _look_at_hands(writer: ScriptWriter) -> None:
    """Hold both hands before the chest and look at them."""
    end = writer.now + writer.draw(2.6, 3.6)
    for hand in (0, 1):
        writer.script.hands.append(Hand(hand, writer.now, 0.8, "shoulder", (-0.05, -0.10, 0.17)))
        writer.rest(hand, end - 0.8, 0.8)
    writer.look_at(writer.now + 0.2, end - 0.6, writer.before_chest(-0.24, 0.19))
    writer.did("look at hands", end)


def _step_sideways(writer: ScriptWriter) -> None:
    """Step sideways, still facing the same way."""
    goal = writer.base.point + writer.side() * writer.draw(0.3, 0.6) * writer.base.left
    writer.did("sidestep", writer.go(replace(writer.base, x=float(goal[0]), z=float(goal[2])), 1.0, 1.5))


def _step_back(writer: ScriptWriter) -> None:
    """Step backwards."""
    goal = writer.base.point - writer.draw(0.3, 0.55) * writer.base.forward
    writer.did("step back", writer.go(replace(writer.base, x=float(goal[0]), z=float(goal[2])), 1.0, 1.5))


def _reach_out(writer: ScriptWriter) -> None:
    """Reach for something without taking it."""
    begin = writer.now + 0.2
    hand = writer.free_hand()
    outwards = (1.0 if hand == 0 else -1.0) * writer.draw(0.02, 0.20)
    point = writer.base.point + writer.draw(0.42, 0.58) * writer.base.forward + outwards * writer.base.left
    point[1] = writer.stature * writer.draw(0.42, 0.92)
    writer.did("reach", writer.reach(hand, point, begin, writer.draw(0.75, 1.1), writer.draw(0.3, 0.7)), hand)


def _rub(writer: ScriptWriter, name: str, size: tuple[float, float], frequency: tuple[float, float]) -> None:
    """Move a hand in circles of this size, metres, before the body, as on a table or in a pot."""
    begin = writer.now
    hand = writer.free_hand()
    length = writer.draw(3.0, 4.2)
    half = writer.draw(*size) / 2.0
    ratio = writer.draw(0.5, 1.0)
    aside = np.array([half, 0.0, 0.0])
    loop = Loop(begin + 0.7, begin + length - 0.7, aside, np.array([0.0, 0.0, half * ratio]), writer.draw(*frequency))
    writer.script.hands.append(Hand(hand, begin, 0.8, "middle", (-0.02, -0.22, 0.21), loop))
    writer.rest(hand, begin + length - 0.75, 0.8)
    writer.look_at(begin + 0.1, begin + length - 0.5, writer.before_chest(-0.35, 0.24))
    if not writer.is_seated:
        writer.bend(begin, 0.7, writer.draw(0.10, 0.25), 0.0)
        writer.bend(begin + length - 0.8, 0.7, 0.0, 0.0)
    writer.did(name, begin + length, hand)


def crouch(writer: ScriptWriter) -> None:
    """Go down with bent knees, and up again."""
    begin = writer.now
    depth = writer.draw(0.32, 0.48)
    down = 0.8 + 1.25 * depth
    stay = writer.draw(0.4, 1.0)
    writer.bend(begin, down, writer.draw(0.35, 0.6), depth)
    writer.bend(begin + down + stay, down, 0.0, 0.0)
    writer.did("crouch", begin + 2 * down + stay)


def _bend_forward(writer: ScriptWriter) -> None:
    """Lean forward with nearly straight legs, and up again."""
    begin = writer.now
    length = writer.draw(1.0, 1.3)
    stay = writer.draw(0.4, 1.0)
    writer.bend(begin, length, writer.draw(0.75, 1.15), writer.draw(0.02, 0.06))
    writer.look(begin + 0.1, begin + length + stay, 0.0, 1.0, 1.2)
    writer.bend(begin + length + stay, length, 0.0, 0.0)
    writer.did("bend", begin + 2 * length + stay)


def wave(writer: ScriptWriter) -> None:
    """Wave a hand beside the head."""
    begin = writer.now
    hand = writer.free_hand()
    frequency = writer.draw(1.5, 2.5)
    waving = int(writer.rng.integers(3, 7)) / frequency
    loop = Loop(begin + 0.75, begin + 0.75 + waving, np.array([0.05, 0.0, 0.0]), np.array([0.0, 0.015, 0.0]), frequency)
    writer.script.hands.append(Hand(hand, begin, 0.8, "shoulder", (0.09, 0.105, 0.08), loop, _WAVING_ELBOW, _BULGE))
    end = begin + 0.75 + waving
    writer.rest(hand, end, 0.9, bulge=_BULGE)
    writer.look(begin, end, writer.draw(-0.2, 0.2), 0.0)
    writer.did("wave", end + 0.8, hand)


def _raise_arms(writer: ScriptWriter) -> None:
    """Raise both arms, and lower them again."""
    begin = writer.now
    up = writer.draw(0.9, 1.2)
    stay = writer.draw(0.4, 1.1)
    for hand in (0, 1):
        place = (writer.draw(0.02, 0.06), 0.265, 0.05)
        writer.script.hands.append(Hand(hand, begin, up, "shoulder", place, bulge=_BULGE))
        writer.rest(hand, begin + up + stay, up, bulge=_BULGE)
    writer.did("raise arms", begin + 2 * up + stay)


def _scratch_head(writer: ScriptWriter) -> None:
    """Rub the head with a hand."""
    begin = writer.now
    hand = writer.free_hand()
    length = writer.draw(2.8, 3.8)
    up = np.array([0.0, 0.012, 0.0])
    loop = Loop(begin + 0.8, begin + length - 0.8, up, np.array([0.0, 0.0, 0.014]), writer.draw(2.0, 3.0))
    writer.script.hands.append(Hand(hand, begin, 0.9, "head", (0.075, 0.045, 0.035), loop, (1.0, -0.3, 0.15), _BULGE))
    writer.rest(hand, begin + length - 0.85, 0.9, bulge=_BULGE)
    writer.did("scratch head", begin + length, hand)


def _change_seat(writer: ScriptWriter, *, down: bool) -> None:
    """Sit down on a chair that is not shown, or stand up from it."""
    writer.sit(down=down)
    writer.did("sit down" if down else "stand up", writer.now + SITTING_TIME + (0.6 if down else 0.5))


Activity = Callable[[ScriptWriter], None]
_walk_straight = partial(_walk, least=-0.05, most=0.05, side=1.0)
_walk_left = partial(_walk, least=0.6, most=1.7, side=1.0)
_walk_right = partial(_walk, least=0.6, most=1.7, side=-1.0)
_wipe = partial(_rub, name="wipe", size=(0.12, 0.15), frequency=(0.8, 1.2))
_stir = partial(_rub, name="stir", size=(0.08, 0.10), frequency=(1.2, 1.6))
_sit_down = partial(_change_seat, down=True)
_stand_up = partial(_change_seat, down=False)

# What somebody who stands may do next, by weight.
STANDING: Mapping[Activity, float] = MappingProxyType(
    {
        _walk_straight: 1.6, _walk_left: 1.0, _walk_right: 1.0, _walk_curve: 1.0, _walk_carrying: 1.0,
        _turn_around: 1.4,
        stand: 0.5, look_around: 1.0, _look_at_hands: 0.7, _step_sideways: 1.0, _step_back: 0.8, _reach_out: 1.6,
        _wipe: 0.8, _stir: 0.8, crouch: 0.8, _bend_forward: 0.8, wave: 0.9, _raise_arms: 0.7, _scratch_head: 0.6,
        _sit_down: 0.9,
    }
)  # fmt: skip

# The same for somebody who sits.
SITTING: Mapping[Activity, float] = MappingProxyType(
    {stand: 0.8, look_around: 0.8, _look_at_hands: 0.7, wave: 0.6, _scratch_head: 0.5, _stir: 0.5, _stand_up: 1.8}
)

# Seconds between two activities; sooner the last foot would not have landed.
PAUSE = (0.32, 0.7)

# Activities that leave time for a second one in the same narration.
SHORT = frozenset({"turn", "sidestep", "step back", "sit down", "stand up"})
