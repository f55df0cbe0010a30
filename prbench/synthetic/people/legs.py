"""Pelvis height and legs over planted and swinging feet (docs/specification/synthetic-recordings.md#base-motion)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from prbench.synthetic.people.base import BasePath, BasePose, Segment
from prbench.synthetic.people.kinematics import direction, eased_trapezoid, minimum_jerk, smooth, turn, two_bone
from prbench.synthetic.people.person import BALL_HEIGHT, Body, Person

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
    """Return the steps that carry a person along the segments of the base."""
    return tuple(step for segment in segments for step in _steps_of(person, segment))


def _steps_of(person: Person, segment: Segment) -> list[Step]:
    duration = segment.end - segment.begin
    walking = segment.kind == "walk"
    # Speed is step length times cadence, and the walk ratio is step length over cadence: their quotient is cadence².
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
    """Return the foot on the side of the turn, or of the side step."""
    if segment.kind == "walk":
        return int(segment.course < segment.start.heading)
    sideways = (segment.goal.point - segment.start.point) @ segment.start.left
    turn = segment.goal.heading - segment.start.heading
    return int(sideways + 0.3 * turn < 0.0)


def place_feet(
    person: Person, base: BasePath, steps: tuple[Step, ...], times: Float[np.ndarray, " n"], *, seated: bool
) -> Feet:
    """Return the balls of both feet over time.

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
    pitch = np.zeros((n, 2))
    planted = np.ones((n, 2), dtype=bool)
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
    """Return where the ball of a foot rests when the base is at ``pose``, and its yaw."""
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
    """Lift the heel before the foot, land with the toes up, and set the foot flat soon after."""
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


_PLANTED_LEG = 0.9885
_LEG_LIMIT = (0.9925, 0.9985)
_POLE_DOWN = np.arctan(0.35)  # stays regular when the foot trails behind a crouching pelvis


@dataclass(frozen=True)
class Legs:
    """Joints of both legs; index 1 is the side."""

    knee: Float[np.ndarray, "n 2 3"]
    ankle: Float[np.ndarray, "n 2 3"]
    ball: Float[np.ndarray, "n 2 3"]


def ankles(body: Body, feet: Feet) -> Float[np.ndarray, "n 2 3"]:
    """Return the ankles of feet that turn and roll about their balls."""
    return feet.ball - turn(feet.yaw, feet.pitch, np.array([0.0, -body.ankle_height, body.foot_length]))


def lowered_pelvis(
    body: Body,
    height: Float[np.ndarray, " n"],
    hips: Float[np.ndarray, "n 2 3"],
    feet: Feet,
    steps: tuple[Step, ...],
    times: Float[np.ndarray, " n"],
    rate: float,
) -> Float[np.ndarray, " n"]:
    """Lower the pelvis where the planted feet ask for it, and nowhere because of the swinging one.

    Args:
        body: Bone lengths.
        height: Wanted pelvis height.
        hips: Hip positions at that height.
        feet: Balls, yaw, pitch and contacts.
        steps: Foot falls.
        times: Frame times, seconds.
        rate: Frames a second.

    Returns:
        Pelvis height at which no planted leg is longer than it can be.
    """
    allowed = _allowed_height(body, height, hips, feet)
    dip = np.zeros(times.size)
    missing = np.maximum(height - allowed, 0.0)
    for step, following in zip(steps, (*steps[1:], None), strict=False):
        upto = step.landing + 0.24 * step.period
        if following is not None and following.lift > step.landing:
            upto = min(upto, following.lift)
        _add_dip(dip, missing, times, (step.landing, upto), 0.42 * step.period)
    lowered = height - smooth(dip, 0.050, rate)
    return smooth(np.minimum(lowered, allowed), 0.025, rate)


def _add_dip(
    dip: np.ndarray, missing: np.ndarray, times: np.ndarray, plateau: tuple[float, float], flank: float
) -> None:
    begin, end = np.searchsorted(times, plateau)
    depth = missing[begin : end + 1].max(initial=0.0)
    if depth <= 0.0:
        return
    first, last = np.searchsorted(times, [plateau[0] - flank, plateau[1] + flank])
    near = times[first:last]
    shape = minimum_jerk((near - plateau[0]) / flank + 1.0) * minimum_jerk((plateau[1] - near) / flank + 1.0)
    dip[first:last] = np.maximum(dip[first:last], depth * shape)


def _allowed_height(body: Body, height: np.ndarray, hips: np.ndarray, feet: Feet) -> np.ndarray:
    """Return the highest pelvis for which every planted leg is at most .9885 of its length."""
    ankle = ankles(body, feet)
    across = hips - ankle
    horizontal = across[..., 0] ** 2 + across[..., 2] ** 2
    reach = np.sqrt(np.maximum((_PLANTED_LEG * body.leg) ** 2 - horizontal, 0.0))
    room = np.where(feet.planted, ankle[..., 1] + reach - hips[..., 1], np.inf).min(axis=1)
    return height + room


def pose_legs(
    body: Body,
    hips: Float[np.ndarray, "n 2 3"],
    pelvis_yaw: Float[np.ndarray, " n"],
    feet: Feet,
) -> Legs:
    """Find the knees by two-bone kinematics; a swinging foot follows the ankle where the leg is too short for it."""
    wanted = ankles(body, feet)
    knees = []
    reached = []
    for side in (0, 1):
        heading = 0.5 * (pelvis_yaw + feet.yaw[:, side])
        knee, ankle = two_bone(
            hips[:, side], wanted[:, side], (body.thigh, body.shin), direction(heading, _POLE_DOWN), _LEG_LIMIT
        )
        knees.append(knee)
        reached.append(ankle)
    ankle = np.stack(reached, axis=1)
    return Legs(np.stack(knees, axis=1), ankle, feet.ball + (ankle - wanted))
