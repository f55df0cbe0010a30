"""Pelvis height and legs over planted and swinging feet (docs/specification/synthetic-recordings.md#base-motion)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.channels import minimum_jerk, smooth
from prbench.synthetic.people.geometry import direction, turn, two_bone
from prbench.synthetic.people.person import Body
from prbench.synthetic.people.steps import Feet, Step

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
    """Ankles of feet that turn and roll about their balls."""
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
    """Highest pelvis for which every planted leg is at most .9885 of its length."""
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
    """Knees by two-bone kinematics; a swinging foot follows the ankle where the leg is too short for it."""
    wanted = ankles(body, feet)
    knees, reached = [], []
    for side in (0, 1):
        heading = 0.5 * (pelvis_yaw + feet.yaw[:, side])
        knee, ankle = two_bone(
            hips[:, side], wanted[:, side], (body.thigh, body.shin), direction(heading, _POLE_DOWN), _LEG_LIMIT
        )
        knees.append(knee)
        reached.append(ankle)
    ankle = np.stack(reached, axis=1)
    return Legs(np.stack(knees, axis=1), ankle, feet.ball + (ankle - wanted))
