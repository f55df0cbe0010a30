"""Foot falls: when which foot steps where, and the way of the balls of the feet.

Source: docs/specification/synthetic-recordings.md#base-motion (steps, ball of the foot, foot pitch).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from prbench.synthetic.people.base import BasePath, BasePose, Segment
from prbench.synthetic.people.channels import eased_trapezoid, minimum_jerk
from prbench.synthetic.people.person import Person
from prbench.synthetic.people.trunk import BALL_HEIGHT

_ROLL_BEFORE_LIFT = 0.05  # the ball begins to rise before it moves, as a rolling foot does
_HEEL_UP = np.deg2rad(48.0)
_TOES_UP = np.deg2rad(-14.0)
_SEATED_FEET_AHEAD = 0.22  # of the stature


@dataclass(frozen=True)
class Step:
    """One foot's way through the air."""

    foot: int
    """0 left, 1 right."""
    lift: float
    period: float
    """Time between two lifts of different feet."""
    swing: float
    walking: bool

    @property
    def landing(self) -> float:
        """The ball is down."""
        return self.lift + self.swing


@dataclass(frozen=True)
class Feet:
    """Both feet at every frame."""

    ball: Float[np.ndarray, "n 2 3"]
    yaw: Float[np.ndarray, "n 2"]
    pitch: Float[np.ndarray, "n 2"]
    """> 0: heel up."""
    planted: Bool[np.ndarray, "n 2"]


def plan_steps(person: Person, segments: tuple[Segment, ...]) -> tuple[Step, ...]:
    """The steps that carry a person along the segments of the base."""
    return tuple(step for segment in segments for step in _steps_of(person, segment))


def _steps_of(person: Person, segment: Segment) -> list[Step]:
    duration = segment.end - segment.begin
    walking = segment.kind == "walk"
    cadence = np.sqrt(60.0 * segment.speed / person.habits.walk_ratio)
    cadence = np.clip(cadence, 78.0 + 32.0 * min(1.0, segment.total_turn / 1.2), 128.0)
    n_steps = max(int(np.ceil(duration * cadence / 60.0)), 3 if segment.distance > 0.5 else 2)
    if not walking:
        n_steps = max(n_steps, int(np.ceil(segment.distance / 0.34)) + 1)
    period = duration / (n_steps - 0.62)
    first = _first_foot(segment)
    swing = (0.76 if walking else 0.80) * period
    return [
        Step((first + number) % 2, segment.begin + number * period, period, swing, walking) for number in range(n_steps)
    ]


def _first_foot(segment: Segment) -> int:
    """The foot on the side of the turn, or of the side step."""
    if segment.kind == "walk":
        return int(segment.course < segment.start.heading)
    sideways = (segment.goal.point - segment.start.point) @ segment.start.left
    turn = segment.goal.heading - segment.start.heading
    return int(sideways + 0.3 * turn < 0.0)


def place_feet(
    person: Person, base: BasePath, steps: tuple[Step, ...], times: Float[np.ndarray, " n"], *, seated: bool
) -> Feet:
    """The balls of both feet over time.

    Args:
        person: Who.
        base: Base pose at every frame.
        steps: Foot falls in the order of their lifts.
        times: Frame times, seconds.
        seated: Whether the feet stand ahead, before a chair.
    """
    n = times.size
    ahead = _SEATED_FEET_AHEAD * person.body.stature if seated else None
    spots = [_plant(person, base.pose(0), foot, 0.0, ahead) for foot in (0, 1)]
    ball = np.stack([np.tile(spot[0], (n, 1)) for spot in spots], axis=1)
    yaw = np.stack([np.full(n, spot[1]) for spot in spots], axis=1)
    pitch, planted = np.zeros((n, 2)), np.ones((n, 2), dtype=bool)
    for step in steps:
        middle = np.searchsorted(times, step.lift + 1.38 * step.period)
        index = int(min(middle, n - 1))
        new_ball, new_yaw = _plant(person, base.pose(index), step.foot, float(base.speed[index]), None)
        old_ball, old_yaw = spots[step.foot]
        spots[step.foot] = new_ball, new_yaw
        stride = float(np.linalg.norm(new_ball - old_ball))
        _swing(ball[:, step.foot], yaw[:, step.foot], times, step, (old_ball, new_ball), (old_yaw, new_yaw))
        _roll(pitch[:, step.foot], times, step, min(1.0, stride / 1.1))
        first, last = np.searchsorted(times, [step.lift - _ROLL_BEFORE_LIFT, step.landing])
        planted[first:last, step.foot] = False
    return Feet(ball, yaw, pitch, planted)


def _plant(
    person: Person, pose: BasePose, foot: int, speed: float, ahead: float | None
) -> tuple[Float[np.ndarray, "3"], float]:
    """Where the ball of a foot rests when the base is at ``pose``, and its yaw."""
    side = 1.0 if foot == 0 else -1.0
    forward = person.body.foot_length * (0.62 - 0.30 * min(1.0, speed)) if ahead is None else ahead
    ball = pose.point + side * person.habits.half_stance * pose.left + forward * pose.forward
    ball[1] = BALL_HEIGHT
    return ball, pose.heading + side * person.habits.toe_out


def _swing(
    ball: np.ndarray,
    yaw: np.ndarray,
    times: np.ndarray,
    step: Step,
    places: tuple[np.ndarray, np.ndarray],
    yaws: tuple[float, float],
) -> None:
    first, last = np.searchsorted(times, [step.lift - _ROLL_BEFORE_LIFT, step.landing])
    elapsed = times[first:last] - step.lift
    stride = float(np.linalg.norm(places[1] - places[0]))
    height = (0.060 + 0.025 * min(stride, 1.2)) * min(1.0, stride / 0.12 + abs(yaws[1] - yaws[0]) / 0.5)
    progress = eased_trapezoid((elapsed / step.swing - 0.10) / 0.82, 0.34, 0.34)
    up = minimum_jerk((elapsed + _ROLL_BEFORE_LIFT) / 0.16)
    down = minimum_jerk((elapsed / step.swing - 0.62) / 0.38)
    ball[first:last] = places[0] + progress[:, None] * (places[1] - places[0])
    ball[first:last, 1] = BALL_HEIGHT + height * up * (1.0 - down)
    ball[last:] = places[1]
    yaw[first:last] = yaws[0] + progress * (yaws[1] - yaws[0])
    yaw[last:] = yaws[1]


def _roll(pitch: np.ndarray, times: np.ndarray, step: Step, factor: float) -> None:
    """Heel off before the lift, toes up at landing, flat soon after."""
    keys = np.array(
        [
            step.lift - 0.55 * step.period,
            step.lift + 0.06,
            step.lift + 0.65 * step.swing,
            step.landing,
            step.landing + 0.1,
        ]
    )
    values = factor * np.array([0.0, _HEEL_UP, 0.0, _TOES_UP, 0.0])
    borders = np.searchsorted(times, keys)
    for part in range(len(keys) - 1):
        span = slice(borders[part], borders[part + 1])
        share = minimum_jerk((times[span] - keys[part]) / (keys[part + 1] - keys[part]))
        pitch[span] += values[part] + share * (values[part + 1] - values[part])
