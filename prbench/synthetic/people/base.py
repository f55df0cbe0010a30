"""The path of the body over the floor: turn, walk, turn; or shuffle.

Source: docs/specification/synthetic-recordings.md#base-motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.kinematics import blend, eased_trapezoid, minimum_jerk, wrap
from prbench.synthetic.people.person import Habits

_WALK_FROM = 0.7  # metres; shorter ways are shuffled
_STAY_WITHIN = 0.04  # metres; nearer, and turned by less than 12 degrees, the feet stay
_STAY_TURN = np.deg2rad(12.0)
# People walk sideways for a step or two at most (Handford & Srinivasan 2014): on longer ways they turn into them.
_SIDESTEP = (0.22, 0.42)  # metres; the turn into the way grows from none to whole between the two
_SIDEWAYS_LEFT = np.deg2rad(40.0)  # angle between body and way that is not turned away
_LARGEST_TURN = np.deg2rad(45.0)
_LARGEST_TURNS = np.deg2rad(55.0)  # with the change of heading: a planted foot must not be left behind the pelvis
_TURNING = 0.42  # share of a shuffle in which the body turns into the way, and of that in which it turns back


@dataclass(frozen=True)
class BasePose:
    """The point under the pelvis and the heading, which is never wrapped."""

    x: float
    z: float
    heading: float

    @property
    def point(self) -> Float[np.ndarray, "3"]:
        """Return the position on the floor: x, 0, z in metres, world frame."""
        return np.array([self.x, 0.0, self.z])

    @property
    def left(self) -> Float[np.ndarray, "3"]:
        """Unit vector to the left."""
        return np.array([np.cos(self.heading), 0.0, -np.sin(self.heading)])

    @property
    def forward(self) -> Float[np.ndarray, "3"]:
        """Unit vector ahead."""
        return np.array([np.sin(self.heading), 0.0, np.cos(self.heading)])


@dataclass(frozen=True)
class Segment:
    """One change of place. Times in seconds of the recording."""

    kind: Literal["walk", "shuffle"]
    start: BasePose
    goal: BasePose
    begin: float
    end: float
    """Base at rest from here on."""
    arrival: float
    """End of the translation."""
    speed: float
    course: float
    """Heading while walking, unwrapped against the start."""
    first_turn: float
    """Duration of the turn into the course."""
    last_turn: float
    translation_begin: float
    turn_into: float = 0.0
    """Of a shuffle: how far the body turns into the way before it turns back, radians; > 0 to the left."""

    @property
    def distance(self) -> float:
        """Metres between start and goal."""
        return float(np.hypot(self.goal.x - self.start.x, self.goal.z - self.start.z))

    @property
    def total_turn(self) -> float:
        """Sum of the turns' sizes, radians."""
        if self.kind == "shuffle":
            return abs(self.goal.heading - self.start.heading) + 2.0 * abs(self.turn_into)
        return abs(self.course - self.start.heading) + abs(self.goal.heading - self.course)


def plan_segment(
    habits: Habits, pace: float, start: BasePose, goal: BasePose, begin: float, *, faces_on: bool = False
) -> Segment | None:
    """Plan the way from one standing place to another.

    Args:
        habits: Of the person.
        pace: The preset's speed factor.
        start: Where the person stands.
        goal: Where to; its heading is understood modulo full turns.
        begin: Motor start.
        faces_on: Whether somebody who shuffles keeps facing the same way, however far.

    Returns:
        The segment, with ``goal`` unwrapped so that the person turns the short way; None if the feet may stay.
    """
    distance = float(np.hypot(goal.x - start.x, goal.z - start.z))
    # Short ways are walked more slowly: the speed nears the usual one over about three quarters of a metre.
    speed = habits.walk_speed * pace * (1.0 - np.exp(-(distance + 0.15) / 0.75))
    if distance > _WALK_FROM:
        return _plan_walk(habits, speed, distance, start, goal, begin)
    turn = float(wrap(goal.heading - start.heading))
    if distance < _STAY_WITHIN and abs(turn) < _STAY_TURN:
        return None
    duration = max(0.55 + 0.8 * distance / max(speed, 0.25), 0.8 + 0.75 * distance, abs(turn) / habits.turn_rate + 0.3)
    turn_into = 0.0 if faces_on else _turn_into(start, goal, distance, turn)
    duration = max(duration, abs(turn_into) / (_TURNING * habits.turn_rate))
    end = begin + duration
    goal = BasePose(goal.x, goal.z, start.heading + turn)
    return Segment("shuffle", start, goal, begin, end, end, speed, start.heading, duration, 0.0, begin, turn_into)


def _turn_into(start: BasePose, goal: BasePose, distance: float, turn: float) -> float:
    """Return how far the body turns towards a way that it shuffles, radians."""
    way = float(wrap(np.arctan2(goal.x - start.x, goal.z - start.z) - start.heading - 0.5 * turn))
    most = max(0.0, min(_LARGEST_TURN, _LARGEST_TURNS - abs(turn)))
    excess = float(np.clip(abs(way) - _SIDEWAYS_LEFT, 0.0, most))
    shortest, longest = _SIDESTEP
    return float(np.sign(way)) * excess * float(minimum_jerk((distance - shortest) / (longest - shortest)))


def _plan_walk(habits: Habits, speed: float, distance: float, start: BasePose, goal: BasePose, begin: float) -> Segment:
    bearing = np.arctan2(goal.x - start.x, goal.z - start.z)
    turn_in = float(wrap(bearing - start.heading))
    course = start.heading + turn_in
    turn_out = float(wrap(goal.heading - course))
    first_turn = max(0.3, abs(turn_in) / habits.turn_rate - 0.15) + 0.25
    last_turn = max(0.9, abs(turn_out) / habits.turn_rate)
    translation_begin = begin + 0.55 * first_turn
    arrival = translation_begin + distance / speed + 0.45
    end = arrival + 0.15 * last_turn
    goal = BasePose(goal.x, goal.z, course + turn_out)
    return Segment("walk", start, goal, begin, end, arrival, speed, course, first_turn, last_turn, translation_begin)


@dataclass(frozen=True)
class BasePath:
    """Base pose at every frame."""

    x: Float[np.ndarray, " n"]
    z: Float[np.ndarray, " n"]
    heading: Float[np.ndarray, " n"]
    speed: Float[np.ndarray, " n"]
    """Metres per second."""

    @cached_property
    def points(self) -> Float[np.ndarray, "n 3"]:
        """Under the pelvis, on the floor."""
        return np.stack([self.x, np.zeros_like(self.x), self.z], axis=-1)

    def pose(self, index: int) -> BasePose:
        """Return the base pose at one frame."""
        return BasePose(float(self.x[index]), float(self.z[index]), float(self.heading[index]))


def sample_base(start: BasePose, segments: tuple[Segment, ...], times: Float[np.ndarray, " n"]) -> BasePath:
    """Return the base pose at every frame of a recording that begins standing at ``start``."""
    position = np.tile([start.x, start.z], (times.size, 1))
    heading = np.full(times.size, start.heading)
    for segment in segments:
        if segment.kind == "shuffle":
            duration = segment.end - segment.begin
            blend(position, times, segment.begin, duration, np.array([segment.goal.x, segment.goal.z]))
            blend(heading, times, segment.begin, duration, segment.goal.heading)
            _turn_there_and_back(heading, times, segment)
        else:
            blend(heading, times, segment.begin, segment.first_turn, segment.course)
            last_begin = segment.arrival - 0.85 * segment.last_turn
            blend(heading, times, last_begin, segment.end - last_begin, segment.goal.heading)
            _translate(position, times, segment)
    velocity = np.gradient(position, times, axis=0)
    return BasePath(position[:, 0], position[:, 1], heading, np.hypot(velocity[:, 0], velocity[:, 1]))


def _turn_there_and_back(heading: np.ndarray, times: np.ndarray, segment: Segment) -> None:
    """Turn into the way of a shuffle and back, on top of the change of heading."""
    if segment.turn_into == 0.0:
        return
    first, last = np.searchsorted(times, [segment.begin, segment.end])
    progress = (times[first:last] - segment.begin) / (segment.end - segment.begin)
    there = minimum_jerk(progress / _TURNING)
    back = minimum_jerk((progress - (1.0 - _TURNING)) / _TURNING)
    heading[first:last] += segment.turn_into * (there - back)


def _translate(position: np.ndarray, times: np.ndarray, segment: Segment) -> None:
    first = int(np.searchsorted(times, segment.translation_begin))
    duration = segment.arrival - segment.translation_begin
    up = min(0.5 / duration, 0.45)
    down = min(0.65 / duration, 0.5)
    progress = eased_trapezoid((times[first:] - segment.translation_begin) / duration, up, down)
    origin = np.array([segment.start.x, segment.start.z])
    goal = np.array([segment.goal.x, segment.goal.z])
    position[first:] = origin + progress[:, None] * (goal - origin)
