"""Wrists, elbows and hands over time (docs/specification/synthetic-recordings.md#reaching-and-holding)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.kinematics import UP, add_bump, blend, frame_of_bone, minimum_jerk, turn, two_bone, unit
from prbench.synthetic.people.person import Body, Trunk
from prbench.synthetic.people.plan import DOOR, Plan, Reach
from prbench.synthetic.people.posture import Sway

_ARM_LIMIT = (0.95, 0.995)
_HANGING = 0.96
_OUTSIDE_SHOULDER = 0.032  # of the stature
_CARRY_AFTER = 0.75
_BACK_WITHIN = 0.8
# Hands that grasp are fastest before the middle of their way and slow from three quarters of it on (Jeannerod 1984).
_REACH_SKEW = 0.25
_HUMP_UP = 0.06
_HUMP_FORWARD = 0.09

_SLIDE_TIME = 0.15
"""Seconds that a nudged object slides."""
_OPENING_TIME = 1.0
"""Seconds in which a door is opened."""
MEETING_TIME = 0.5
"""Seconds in which the hands meet for a hand-over."""
HANDING_TIME = 0.6
"""Seconds in which the object goes from hand to hand."""
_DOOR_WIDTH_HALF = float(cast(tuple[float, float, float], DOOR.half_extents)[0])


@dataclass(frozen=True)
class Arms:
    """Joints of both arms; index 1 is the side."""

    elbow: Float[np.ndarray, "n 2 3"]
    wrist: Float[np.ndarray, "n 2 3"]
    hinge: Float[np.ndarray, "n 2 3"]
    """Unit normal of the arm plane: the elbow's axis, pointing left at neutral."""


def move_wrists(plan: Plan, trunk: Trunk, sway: Sway, times: np.ndarray) -> Float[np.ndarray, "n 2 3"]:
    """Return where the wrists are meant to be: waiting, reaching, carrying. Commands are applied in time order."""
    rest = [_resting_wrist(plan, trunk, sway, hand) for hand in (0, 1)]
    carry = [_offset_from_shoulder(plan, trunk, hand, plan.preset.carry_pose) for hand in (0, 1)]
    wrists = [waiting.copy() for waiting in rest]
    for reach in plan.reaches:
        if reach.twist.handed_over is not None:
            _hand_over(plan, wrists, rest, carry, reach, trunk, times)
        _reach(wrists[reach.hand], reach, np.zeros(3), times)
        _leave(wrists[reach.hand], reach, rest[reach.hand], carry[reach.hand], times)
        if reach.twist.second_hand:
            _second_hand(wrists[1 - reach.hand], reach, rest[1 - reach.hand], carry[reach.hand], trunk, times)
    return np.stack(wrists, axis=1)


def _reach(wrist: np.ndarray, reach: Reach, beside: np.ndarray, times: np.ndarray) -> None:
    """Move a wrist to the grasp, on a path that bulges up and forward: past the table's edge and the own shoulder."""
    duration = reach.contact - reach.reach_start
    blend(wrist, times, reach.reach_start, duration, reach.grasp.wrist + beside, skew=_REACH_SKEW)
    add_bump(wrist, times, reach.reach_start, duration, _HUMP_UP * UP + _HUMP_FORWARD * reach.base.forward)


def _leave(wrist: np.ndarray, reach: Reach, rest: np.ndarray, carry: np.ndarray, times: np.ndarray) -> None:
    """Carry away what was picked; else stay a little, with what slides or turns, and go back."""
    if reach.carries:
        blend(wrist, times, reach.event, _CARRY_AFTER, carry)
        return
    if reach.twist.slide is not None or reach.twist.opening:
        first = int(np.searchsorted(times, reach.event))
        wrist[first:] = moved_along(reach, reach.grasp.wrist, times[first:])
    if np.isfinite(reach.dwell):
        blend(wrist, times, reach.event + reach.dwell, _BACK_WITHIN, rest)


def moved_along(
    reach: Reach, point: Float[np.ndarray, "3"], times: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Return where a point fixed to a nudged or hinged object is after the event."""
    if reach.twist.slide is not None:
        return point + minimum_jerk((times - reach.event) / _SLIDE_TIME)[:, None] * reach.twist.slide
    axis = reach.centre + turn(reach.yaw, 0.0, np.array([_DOOR_WIDTH_HALF, 0.0, 0.0]))
    return axis + turn(opened(reach, times), 0.0, point - axis)


def opened(reach: Reach, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the angle of a door that is pulled towards the person, radians."""
    return -reach.twist.opening * minimum_jerk((times - reach.event) / _OPENING_TIME)


def _second_hand(
    wrist: np.ndarray, reach: Reach, rest: np.ndarray, carry: np.ndarray, trunk: Trunk, times: np.ndarray
) -> None:
    """Let the other hand join after the lift, some way beside the first, and help to put down."""
    towards_other = 1.0 if reach.hand == 1 else -1.0
    beside = np.array([towards_other * reach.twist.second_hand, 0.0, 0.0])
    if reach.action == "pick":
        joined = carry + turn(trunk.yaws[3], 0.0, beside)
        blend(wrist, times, reach.event + 0.2, _CARRY_AFTER - 0.2, joined)
        return
    _reach(wrist, reach, turn(reach.base.heading, 0.0, beside), times)
    blend(wrist, times, reach.event + reach.dwell, _BACK_WITHIN, rest)


def _hand_over(
    plan: Plan,
    wrists: list[np.ndarray],
    rest: list[np.ndarray],
    carry: list[np.ndarray],
    put: Reach,
    trunk: Trunk,
    times: np.ndarray,
) -> None:
    """Let both hands meet before the chest; one leaves, the other carries on."""
    begin = put.twist.handed_over
    assert begin is not None  # the caller asks for it only then
    middle = 0.5 * (trunk.shoulders[0] + trunk.shoulders[1])
    stature = plan.person.body.stature
    for hand in (0, 1):
        offset = np.array([0.08 if hand == 0 else -0.08, -0.18 * stature, 0.21 * stature])
        blend(wrists[hand], times, begin, MEETING_TIME, middle + turn(trunk.yaws[3], 0.0, offset))
    handed = begin + MEETING_TIME + HANDING_TIME
    blend(wrists[1 - put.hand], times, handed, _BACK_WITHIN, rest[1 - put.hand])
    blend(wrists[put.hand], times, handed, 0.5, carry[put.hand])


def _resting_wrist(plan: Plan, trunk: Trunk, sway: Sway, hand: int) -> np.ndarray:
    if plan.preset.work_pose is not None:
        return _offset_from_shoulder(plan, trunk, hand, plan.preset.work_pose) + sway.hands[:, hand]
    body = plan.person.body
    side = 1.0 if hand == 0 else -1.0
    outside = _OUTSIDE_SHOULDER * body.stature
    length = np.sqrt((_HANGING * body.arm) ** 2 - outside**2)
    angle = side * plan.person.habits.arm_swing * sway.arm_swing
    hanging = np.stack([np.full(angle.size, side * outside), -length * np.cos(angle), length * np.sin(angle)], axis=-1)
    return trunk.shoulders[hand] + turn(trunk.yaws[3], 0.0, hanging) + sway.hands[:, hand]


def _offset_from_shoulder(plan: Plan, trunk: Trunk, hand: int, offset: tuple[float, float, float]) -> np.ndarray:
    """Return a place relative to the shoulder: outwards, up, forward; fractions of the stature."""
    side = 1.0 if hand == 0 else -1.0
    scaled = plan.person.body.stature * np.array([side * offset[0], offset[1], offset[2]])
    return trunk.shoulders[hand] + turn(trunk.yaws[3], 0.0, scaled)


def elbow_poles(flare: float, trunk: Trunk, wrists: Float[np.ndarray, "n 2 3"]) -> Float[np.ndarray, "n 2 3"]:
    """Return where the elbows point, in the chest's frame; follows the direction of the arm.

    A fixed pole would be antiparallel to an arm that reaches up and forward, and the elbow would flip. Upward is the
    chest's: in a deep bend, the world's would leave the pole antiparallel to an arm that hangs in front of the face.
    """
    chest_up = turn(trunk.yaws[3], trunk.pitches[3], np.array([0.0, 1.0, 0.0]))
    poles = []
    for hand in (0, 1):
        side = 1.0 if hand == 0 else -1.0
        upward = np.sum(unit(wrists[:, hand] - trunk.shoulders[hand]) * chest_up, axis=-1)
        raised = minimum_jerk((upward + 0.3) / 0.8)
        outward = side * (flare + 0.6 * raised)
        poles.append(np.stack([outward, np.full(upward.size, -0.85), -0.65 * (1.0 - raised)], axis=-1))
    return np.stack(poles, axis=1)


def pose_arms(
    body: Body,
    flare: float,
    trunk: Trunk,
    wrists: Float[np.ndarray, "n 2 3"],
    poles: Float[np.ndarray, "n 2 3"] | None = None,
) -> Arms:
    """Find the elbows by two-bone kinematics.

    Args:
        body: Bone lengths.
        flare: How far the elbows stand out.
        trunk: Shoulders and chest.
        wrists: Wanted wrists.
        poles: Where the elbows point, chest frame; :func:`elbow_poles` if None.
    """
    elbows = []
    reached = []
    hinges = []
    poles = elbow_poles(flare, trunk, wrists) if poles is None else poles
    for hand in (0, 1):
        shoulder = trunk.shoulders[hand]
        pole = turn(trunk.yaws[3], trunk.pitches[3], poles[:, hand])
        elbow, wrist = two_bone(shoulder, wrists[:, hand], (body.upper_arm, body.forearm), pole, _ARM_LIMIT)
        elbows.append(elbow)
        reached.append(wrist)
        hinges.append(unit(np.cross(wrist - elbow, elbow - shoulder)))
    return Arms(np.stack(elbows, axis=1), np.stack(reached, axis=1), np.stack(hinges, axis=1))


def turn_hands(plan: Plan, arms: Arms, times: np.ndarray) -> Float[np.ndarray, "n 2 3 3"]:
    """Return world from hand: y from wrist to finger base along the forearm, turned into the grasp around an event."""
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
            leave = reach.event + (0.0 if reach.carries else reach.dwell)
            if np.isfinite(leave):
                blend(axes, times, leave, _BACK_WITHIN, neutral)
        frames.append(frame_of_bone(axes[:, 1], axes[:, 0]))
    return np.stack(frames, axis=1)
