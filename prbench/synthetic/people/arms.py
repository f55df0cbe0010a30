"""Wrists, elbows and hands over time (``methods/synthetic-recordings.md`` section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.channels import add_bump, blend, minimum_jerk
from prbench.synthetic.people.geometry import UP, frame_of_bone, turn, two_bone, unit
from prbench.synthetic.people.person import Body
from prbench.synthetic.people.plan import Plan, Reach
from prbench.synthetic.people.posture import Sway
from prbench.synthetic.people.trunk import Trunk

_ARM_LIMIT = (0.95, 0.995)
_HANGING = 0.96
_OUTSIDE_SHOULDER = 0.032  # of the stature
_CARRY_AFTER = 0.75
_STAY_AFTER_PUT = 0.18
_BACK_WITHIN = 0.8
_HUMP_UP, _HUMP_FORWARD = 0.06, 0.09


@dataclass(frozen=True)
class Arms:
    """Joints of both arms; index 1 is the side."""

    elbow: Float[np.ndarray, "n 2 3"]
    wrist: Float[np.ndarray, "n 2 3"]
    hinge: Float[np.ndarray, "n 2 3"]
    """Unit normal of the arm plane: the elbow's axis, pointing left at neutral."""


def move_wrists(plan: Plan, trunk: Trunk, sway: Sway, times: np.ndarray) -> Float[np.ndarray, "n 2 3"]:
    """Where the wrists are meant to be: waiting, reaching, carrying."""
    wrists = []
    for hand in (0, 1):
        rest = _resting_wrist(plan, trunk, sway, hand)
        carry = _offset_from_shoulder(plan, trunk, hand, plan.preset.carry_pose)
        wrist = rest.copy()
        for reach in plan.reaches:
            if reach.hand == hand:
                _reach(wrist, reach, rest, carry, times, carries=plan.preset.puts and reach.action == "pick")
        wrists.append(wrist)
    return np.stack(wrists, axis=1)


def _reach(
    wrist: np.ndarray, reach: Reach, rest: np.ndarray, carry: np.ndarray, times: np.ndarray, *, carries: bool
) -> None:
    duration = reach.contact - reach.reach_start
    blend(wrist, times, reach.reach_start, duration, reach.grasp.wrist)
    add_bump(wrist, times, reach.reach_start, duration, _HUMP_UP * UP + _HUMP_FORWARD * reach.base.forward)
    if carries:
        blend(wrist, times, reach.event, _CARRY_AFTER, carry)
    else:
        blend(wrist, times, reach.event + _STAY_AFTER_PUT, _BACK_WITHIN, rest)


def _resting_wrist(plan: Plan, trunk: Trunk, sway: Sway, hand: int) -> np.ndarray:
    if plan.preset.work_pose is not None:
        return _offset_from_shoulder(plan, trunk, hand, plan.preset.work_pose) + sway.hands[:, hand]
    body, side = plan.person.body, (1.0 if hand == 0 else -1.0)
    outside = _OUTSIDE_SHOULDER * body.stature
    length = np.sqrt((_HANGING * body.arm) ** 2 - outside**2)
    angle = side * plan.person.habits.arm_swing * sway.arm_swing
    hanging = np.stack(
        [np.full(angle.size, side * outside), -length * np.cos(angle), length * np.sin(angle)], axis=-1
    )
    return trunk.shoulders[hand] + turn(trunk.yaws[3], 0.0, hanging) + sway.hands[:, hand]


def _offset_from_shoulder(plan: Plan, trunk: Trunk, hand: int, offset: tuple[float, float, float]) -> np.ndarray:
    """A place relative to the shoulder: outwards, up, forward; fractions of the stature."""
    side = 1.0 if hand == 0 else -1.0
    scaled = plan.person.body.stature * np.array([side * offset[0], offset[1], offset[2]])
    return trunk.shoulders[hand] + turn(trunk.yaws[3], 0.0, scaled)


def pose_arms(body: Body, flare: float, trunk: Trunk, wrists: Float[np.ndarray, "n 2 3"]) -> Arms:
    """Elbows by two-bone kinematics with a pole that follows the direction of the arm.

    A fixed pole would be antiparallel to an arm that reaches up and forward, and the elbow would flip.
    """
    elbows, reached, hinges = [], [], []
    for hand in (0, 1):
        shoulder, side = trunk.shoulders[hand], (1.0 if hand == 0 else -1.0)
        upward = unit(wrists[:, hand] - shoulder)[:, 1]
        raised = minimum_jerk((upward + 0.3) / 0.8)
        pole = np.stack(
            [side * (flare + 0.6 * raised), np.full(upward.size, -0.85), -0.65 * (1.0 - raised)], axis=-1
        )
        pole = turn(trunk.yaws[3], trunk.pitches[3], pole)
        elbow, wrist = two_bone(shoulder, wrists[:, hand], (body.upper_arm, body.forearm), pole, _ARM_LIMIT)
        elbows.append(elbow)
        reached.append(wrist)
        hinges.append(unit(np.cross(wrist - elbow, elbow - shoulder)))
    return Arms(np.stack(elbows, axis=1), np.stack(reached, axis=1), np.stack(hinges, axis=1))


def turn_hands(plan: Plan, arms: Arms, times: np.ndarray) -> Float[np.ndarray, "n 2 3 3"]:
    """World from hand: y from wrist to finger base along the forearm, turned into the grasp around an event."""
    frames = []
    for hand in (0, 1):
        forearm = unit(arms.wrist[:, hand] - arms.elbow[:, hand])
        neutral = np.stack([arms.hinge[:, hand], forearm], axis=1)
        axes = neutral.copy()
        for reach in plan.reaches:
            if reach.hand != hand:
                continue
            begin = reach.reach_start
            blend(axes, times, begin, reach.contact - begin, reach.grasp.hand.T[:2])
            carries = plan.preset.puts and reach.action == "pick"
            blend(axes, times, reach.event + (0.0 if carries else _STAY_AFTER_PUT), _BACK_WITHIN, neutral)
        frames.append(frame_of_bone(axes[:, 1], axes[:, 0]))
    return np.stack(frames, axis=1)
