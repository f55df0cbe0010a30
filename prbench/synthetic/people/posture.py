"""Pelvis and trunk over time: leaning and crouching for reaches, walking, and following the head.

Sources: docs/specification/synthetic-recordings.md#base-motion,
docs/specification/synthetic-recordings.md#reaching-and-holding and
docs/specification/synthetic-recordings.md#eye-head-trunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.base import BasePath
from prbench.synthetic.people.grasp import Posture, pelvis_setback
from prbench.synthetic.people.head_eye import Head
from prbench.synthetic.people.kinematics import blend, smooth, two_pole_low_pass, wobble
from prbench.synthetic.people.legs import Feet, Step, lowered_pelvis
from prbench.synthetic.people.person import Trunk, pose_trunk, standing_pelvis_height
from prbench.synthetic.people.plan import Plan

_CHEST_LIMIT = np.deg2rad(49.0)
_PELVIS_LIMIT = np.deg2rad(17.0)
_LEAN_PER_SPEED = 0.03  # radians per m/s
_CHEST_SWING = 0.06  # radians
_PELVIS_SWING = 0.05
_FULL_SWING_SPEED = 1.1  # m/s


@dataclass(frozen=True)
class Sway:
    """Small movements of somebody who stands or walks; drawn once, whatever the reaches need."""

    lateral: Float[np.ndarray, " n"]
    """Pelvis to the left, metres."""
    forward: Float[np.ndarray, " n"]
    lean: Float[np.ndarray, " n"]
    """Radians."""
    arm_swing: Float[np.ndarray, " n"]
    """-1.1 to 1.1: left arm forward, right arm back."""
    hands: Float[np.ndarray, "n 2 3"]
    """Tremor of the resting hands, metres."""


def draw_sway(plan: Plan, base: BasePath, steps: tuple[Step, ...], times: np.ndarray, rng: np.random.Generator) -> Sway:
    """Draw the wobbles of a recording, and the swing of pelvis and arms over its steps."""
    rate = 1.0 / (times[1] - times[0])
    lateral = np.zeros(times.size)
    swing = np.zeros(times.size)
    for step in steps:
        first, last = np.searchsorted(times, [step.lift, step.landing])
        towards_stance = -1.0 if step.foot == 0 else 1.0
        lateral[first:last] += 0.018 * towards_stance * np.sin(np.pi * (times[first:last] - step.lift) / step.swing)
        if step.walking:
            first, last = np.searchsorted(times, [step.lift, step.lift + step.period])
            swing[first:last] = -towards_stance * np.cos(np.pi * (times[first:last] - step.lift) / step.period)
    swing *= np.minimum(_FULL_SWING_SPEED, base.speed / _FULL_SWING_SPEED)
    hand_wobble = _hand_wobble(plan, times, rng)
    return Sway(
        lateral=smooth(lateral, 0.060, rate) + wobble(times, 0.006, 0.05, 0.4, rng),
        forward=wobble(times, 0.005, 0.05, 0.5, rng),
        lean=_LEAN_PER_SPEED * smooth(base.speed, 0.10, rate) + wobble(times, np.deg2rad(0.6), 0.05, 0.4, rng),
        arm_swing=smooth(swing, 0.060, rate),
        hands=hand_wobble,
    )


def _hand_wobble(plan: Plan, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw the tremble of hanging hands, or the movements of hands at work."""
    if plan.preset.work_pose is None:
        size = float(rng.uniform(0.006, 0.010))
        low = 0.05
        high = 0.5
    else:
        size = 0.03
        low = 0.2
        high = 1.0
    waves = [wobble(times, size / np.sqrt(3.0), low, high, rng) for _ in range(6)]
    return np.stack(waves, axis=-1).reshape(times.size, 2, 3)


@dataclass(frozen=True)
class Bending:
    """Bending of the trunk that the reaches ask for, at every frame."""

    lean: Float[np.ndarray, " n"]
    crouch: Float[np.ndarray, " n"]
    chest_turn: Float[np.ndarray, " n"]


def bend(plan: Plan, postures: list[Posture], times: np.ndarray) -> Bending:
    """Blend from reach to reach: down before the event, up again after it."""
    channels = np.zeros((times.size, 3))
    for reach, posture in zip(plan.reaches, postures, strict=True):
        begin = reach.reach_start - 0.1
        end = reach.event - 0.05
        blend(channels, times, begin, end - begin, np.array([posture.lean, posture.crouch, posture.chest_turn]))
        if np.isfinite(reach.dwell):
            release = reach.event + 0.12 + max(reach.dwell - 0.18, 0.0) * (not reach.carries)
            blend(channels, times, release, 0.8 + 1.25 * posture.crouch, np.zeros(3))
    return Bending(channels[:, 0], channels[:, 1], channels[:, 2])


def move_trunk(
    plan: Plan,
    base: BasePath,
    bending: Bending,
    sway: Sway,
    feet: Feet,
    steps: tuple[Step, ...],
    times: Float[np.ndarray, " n"],
    head: Head | None,
) -> Trunk:
    """Return the pelvis, spine and shoulders at every frame.

    Args:
        plan: Person and preset.
        base: Base pose at every frame.
        bending: Of the reaches.
        sway: Small movements.
        feet: Contacts that limit the pelvis height.
        steps: Foot falls.
        times: Frame times, seconds.
        head: True head orientation that the trunk follows; None leaves the trunk along the heading.
    """
    body = plan.person.body
    habits = plan.person.habits
    rate = 1.0 / (times[1] - times[0])
    chest_follow = np.zeros(times.size)
    pelvis_follow = np.zeros(times.size)
    if head is not None:
        chest_follow, pelvis_follow = _follow_head(plan, head.yaw - base.heading, rate)
    pelvis_yaw = base.heading + pelvis_follow + 0.3 * bending.chest_turn + _PELVIS_SWING * sway.arm_swing
    chest_yaw = base.heading + chest_follow + 0.5 * bending.chest_turn - _CHEST_SWING * sway.arm_swing
    lean = bending.lean + sway.lean

    forward = np.stack([np.sin(base.heading), np.zeros(times.size), np.cos(base.heading)], axis=-1)
    left = np.stack([forward[:, 2], np.zeros(times.size), -forward[:, 0]], axis=-1)
    ahead = sway.forward - pelvis_setback(body, bending.lean, bending.crouch)
    pelvis = base.points + ahead[:, None] * forward + sway.lateral[:, None] * left
    if plan.pelvis_height is not None:
        pelvis[:, 1] = plan.pelvis_height
        return pose_trunk(body, habits.stoop, pelvis, pelvis_yaw, chest_yaw, lean)
    pelvis[:, 1] = standing_pelvis_height(body) - bending.crouch * body.leg - 0.02 * lean
    upright = pose_trunk(body, habits.stoop, pelvis, pelvis_yaw, chest_yaw, lean)
    pelvis[:, 1] = lowered_pelvis(body, pelvis[:, 1], np.stack(upright.hips, axis=1), feet, steps, times, rate)
    return pose_trunk(body, habits.stoop, pelvis, pelvis_yaw, chest_yaw, lean)


def _follow_head(plan: Plan, turned: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the turns of chest and pelvis against the heading: low-passed shares of the head's turn."""
    habits = plan.person.habits
    extra = plan.preset.chest_gain
    chest = two_pole_low_pass((habits.chest_share + extra) * turned, habits.trunk_time, rate)
    share = habits.pelvis_share + 0.3 * max(0.0, extra)
    pelvis = two_pole_low_pass(share * turned, 1.4 * habits.trunk_time, rate)
    return _soft_clip(chest, _CHEST_LIMIT), _soft_clip(pelvis, _PELVIS_LIMIT)


def _soft_clip(values: np.ndarray, limit: float) -> np.ndarray:
    """Clip without a corner: straight up to 80 % of the limit."""
    size = np.abs(values)
    begin = 0.8 * limit
    soft = begin + 0.2 * limit * np.tanh((size - begin) / (0.2 * limit))
    return np.where(size > begin, np.sign(values) * soft, values)
