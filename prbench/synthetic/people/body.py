"""Head and eyes that follow one list of fixations (docs/specification/synthetic-recordings.md#eye-head-trunk)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people import kinematics
from prbench.synthetic.people.gaze_plan import GazePlan, Look
from prbench.synthetic.people.person import Body, Trunk, pose_trunk, standing_pelvis_height
from prbench.synthetic.people.plan import DOOR, Plan, Reach
from prbench.synthetic.people.reaching import Posture, pelvis_setback
from prbench.synthetic.people.walking import BasePath, Feet, Steps, lowered_pelvis
from prbench.synthetic.performance import Manner

Signal = Float[np.ndarray, " n"]  # one number a time
Points = Float[np.ndarray, "n 3"]  # metres
Sides = Float[np.ndarray, "n 2 3"]  # left and right, metres

_HEAD_YAW = np.deg2rad(100.0)
_HEAD_UP = np.deg2rad(-34.0)
_HEAD_DOWN = np.deg2rad(66.0)
_FASTEST_HEAD = np.deg2rad(270.0)
_FASTEST_PURSUIT = np.deg2rad(120.0)
_EYE_YAW = np.deg2rad(45.0)
_EYE_UP = np.deg2rad(-32.0)
_EYE_DOWN = np.deg2rad(40.0)
_LONGEST_SACCADE = 0.3  # s
_HEAD_SPREAD = 0.15  # log-sd of the time that a turn of the head takes
_SHORT_FILL = 0.35  # s; the head does not follow shorter looks
_SHORT_GOAL_LOOK = 0.5


@dataclass(frozen=True)
class Head:
    """True head orientation, radians: yaw in the world (not wrapped) and pitch (> 0 down)."""

    yaw: Signal
    pitch: Signal


def move_head(
    plan: Plan, gaze: GazePlan, heading: Signal, eye: Points, times: Signal, rng: np.random.Generator
) -> Head:
    """Return the head's orientation over time.

    Args:
        plan: Gains of the preset; gains, lag and eye-only range of the person.
        gaze: Fixations.
        heading: Heading of the base, radians, unwrapped.
        eye: About where the eyes are.
        times: Frame times, seconds.
        rng: Generator of tremor and of the times that turns take.
    """
    habits = plan.person.habits
    manner = plan.person.manner
    frame_time = float(times[1] - times[0])
    # Each command is one head movement: towards a point until the fixation ends, then frozen relative to the heading.
    # It holds its first frame, start and duration, and the target (yaw against the heading, pitch) of the frames until
    # it is frozen.
    commands: list[tuple[int, float, float, np.ndarray]] = []

    def obey(channel: np.ndarray, first: int, start: float, duration: float, target: np.ndarray) -> None:
        until = min(max(int(np.searchsorted(times, start + duration)), first + len(target)), times.size)
        wanted = target[np.minimum(np.arange(until - first), len(target) - 1)]
        progress = manner.turn_head(np.clip((times[first:until] - start) / duration, 0.0, 1.0))[:, None]
        moved = channel[first:until] * (1.0 - progress) + progress * wanted
        channel[first:until] = np.where(progress < 1.0, moved, wanted)
        channel[until:] = target[-1]

    channel = np.zeros((times.size, 2))
    turn_rate = np.abs(np.gradient(heading, times))
    goal_gains = plan.preset.head_gain * np.array([habits.goal_gain, habits.goal_gain_vertical])
    fill_gains = np.array([habits.fill_gain, habits.fill_gain_vertical])
    for look in gaze.looks:
        start = look.start + habits.head_lag
        first, frozen = (int(place) for place in np.searchsorted(times, [start, look.end]))
        if first >= times.size:
            break
        frozen = max(frozen, first + 1)
        present = channel[first]
        # The direction against the heading; wrapped once, at the first frame, then continuous: the bearing of a point
        # right below the eyes swings around with every step, and the head does not.
        yaw, pitch = kinematics.yaw_and_pitch(look.point - eye[first:frozen])
        relative = np.unwrap(yaw) - heading[first:frozen]
        relative += kinematics.wrap(relative[0] - 0.3 * present[0]) + 0.3 * present[0] - relative[0]
        step = _FASTEST_PURSUIT * frame_time
        relative[1:] = relative[0] + np.cumsum(np.clip(np.diff(relative), -step, step))
        wanted = np.stack([np.clip(relative, -_HEAD_YAW, _HEAD_YAW), np.clip(pitch, _HEAD_UP, _HEAD_DOWN)], axis=-1)
        away = np.hypot(*(wanted[0] - present))
        length = look.end - look.start
        if not look.is_goal and (length < _SHORT_FILL or away < habits.eye_only_range + np.deg2rad(6.0)):
            continue
        gains = fill_gains
        if look.is_goal:
            gains = goal_gains if length >= _SHORT_GOAL_LOOK else 0.5 * (goal_gains + fill_gains)
        target = wanted * gains
        amplitude = float(np.hypot(*(target[0] - present)))
        if commands and start - commands[-1][1] < 0.7:
            amplitude = max(amplitude, float(np.hypot(*(target[0] - commands[-1][3][0]))))
        degrees = np.rad2deg(amplitude)
        least, a_degree = manner.head_turn
        varied = float(np.exp(_HEAD_SPREAD * rng.standard_normal()))
        # A head that turns together with the body takes longer, up to 1.6 times.
        slower = 1.0 + min(float(np.rad2deg(turn_rate[first])) / 250.0, 0.6)
        commands.append((first, start, (least + a_degree * degrees) * slower * varied, target))
        obey(channel, *commands[-1])
    for _ in range(6):
        fast = times[np.abs(np.gradient(heading + channel[:, 0], times)) > _FASTEST_HEAD]
        slowed = []
        for first, start, duration, target in commands:
            begin, end = np.searchsorted(fast, [start - 0.02, start + duration + 0.02])
            slowed.append((first, start, duration * 1.35 if end > begin else duration, target))
        if all(new[2] == old[2] for new, old in zip(slowed, commands, strict=True)):
            break
        commands = slowed
        channel = np.zeros((times.size, 2))
        for command in commands:
            obey(channel, *command)
    tremor = np.stack([kinematics.wobble(times, np.deg2rad(0.5), 0.2, 1.5, rng) for _ in range(2)], axis=-1)
    steady = kinematics.smooth(channel, 0.030, 1.0 / (times[1] - times[0])) + tremor
    return Head(heading + steady[:, 0], steady[:, 1])


def move_eyes(looks: tuple[Look, ...], head: Head, eye: Points, times: Signal, rng: np.random.Generator) -> Points:
    """Return the unit gaze directions: saccades, fixation of points in the world, limits of the eye in the head.

    Args:
        looks: Fixations without gaps.
        head: True head orientation.
        eye: True eye positions.
        times: Frame times, seconds.
        rng: Generator of the drift during fixation.
    """
    drift = np.stack([kinematics.wobble(times, np.deg2rad(0.3), 0.3, 3.0, rng) for _ in range(2)], axis=-1)
    gaze = np.stack([head.yaw, head.pitch], axis=-1)
    low = np.stack([head.yaw - _EYE_YAW, head.pitch + _EYE_UP], axis=-1)
    high = np.stack([head.yaw + _EYE_YAW, head.pitch + _EYE_DOWN], axis=-1)
    for look in looks:
        first, last = np.searchsorted(times, [look.start, look.end + _LONGEST_SACCADE])
        if first >= times.size:
            break
        yaw, pitch = kinematics.yaw_and_pitch(look.point - eye[first:last])
        yaw = np.unwrap(yaw)
        yaw += kinematics.wrap(yaw[0] - head.yaw[first]) + head.yaw[first] - yaw[0]
        target = np.stack([yaw, pitch], axis=-1) + drift[first:last]
        # 21 ms and 2.2 ms a degree: the duration of saccades grows linearly with their amplitude.
        saccade = 0.021 + 0.0022 * float(np.rad2deg(np.hypot(*(target[0] - gaze[first]))))
        progress = kinematics.minimum_jerk((times[first:last] - look.start) / saccade)[:, None]
        blended = np.where(progress < 1.0, gaze[first:last] + progress * (target - gaze[first:last]), target)
        gaze[first:last] = np.clip(blended, low[first:last], high[first:last])
    return kinematics.direction(gaze[:, 0], gaze[:, 1])


_CHEST_LIMIT = np.deg2rad(49.0)
_PELVIS_LIMIT = np.deg2rad(17.0)
_LEAN_PER_SPEED = 0.03  # radians per m/s
_CHEST_SWING = 0.06  # radians
_PELVIS_SWING = 0.05
_FULL_SWING_SPEED = 1.1  # m/s


@dataclass(frozen=True)
class Sway:
    """Small movements of somebody who stands or walks; drawn once, whatever the reaches need.

    Attributes:
        lateral: Pelvis to the left, metres.
        lean: Radians.
        arm_swing: -1.1 to 1.1: left arm forward, right arm back.
        hands: Tremor of the resting hands, metres.
    """

    lateral: Signal
    forward: Signal
    lean: Signal
    arm_swing: Signal
    hands: Sides


def draw_sway(plan: Plan, base: BasePath, steps: Steps, times: np.ndarray, rng: np.random.Generator) -> Sway:
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
    # Draw the movements of hands at work, or the tremble of hanging hands.
    size, low, high = 0.03, 0.2, 1.0
    if plan.preset.work_pose is None:
        size, low, high = float(rng.uniform(0.006, 0.010)), 0.05, 0.5
    waves = [kinematics.wobble(times, size / np.sqrt(3.0), low, high, rng) for _ in range(6)]
    return Sway(
        lateral=kinematics.smooth(lateral, 0.060, rate) + kinematics.wobble(times, 0.006, 0.05, 0.4, rng),
        forward=kinematics.wobble(times, 0.005, 0.05, 0.5, rng),
        lean=_LEAN_PER_SPEED * kinematics.smooth(base.speed, 0.10, rate)
        + kinematics.wobble(times, np.deg2rad(0.6), 0.05, 0.4, rng),
        arm_swing=kinematics.smooth(swing, 0.060, rate),
        hands=np.stack(waves, axis=-1).reshape(times.size, 2, 3),
    )


@dataclass(frozen=True)
class Bending:
    """Bending of the trunk that the reaches ask for, at every frame."""

    lean: Signal
    crouch: Signal
    chest_turn: Signal


def bend(plan: Plan, postures: list[Posture], times: np.ndarray) -> Bending:
    """Blend from reach to reach: down before the event, up again after it."""
    channels = np.zeros((times.size, 3))
    for reach, posture in zip(plan.reaches, postures, strict=True):
        begin = reach.reach_start - 0.1
        end = reach.event - 0.05
        bent = np.array([posture.lean, posture.crouch, posture.chest_turn])
        kinematics.blend(channels, times, begin, end - begin, bent, shape=plan.person.manner.reach)
        if np.isfinite(reach.dwell):
            release = reach.event + 0.12 + max(reach.dwell - 0.18, 0.0) * (not reach.carries)
            kinematics.blend(channels, times, release, 0.8 + 1.25 * posture.crouch, np.zeros(3))
    return Bending(channels[:, 0], channels[:, 1], channels[:, 2])


def move_trunk(
    plan: Plan, base: BasePath, bending: Bending, sway: Sway, feet: Feet, steps: Steps, times: Signal, head: Head | None
) -> Trunk:
    """Return the pelvis, spine and shoulders at every frame.

    Args:
        plan: Person and preset.
        base: Base pose at every frame.
        bending: Bending that the reaches ask for.
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
        # Chest and pelvis turn by low-passed shares of the head's turn.
        turned = head.yaw - base.heading
        extra = plan.preset.chest_gain
        chest = kinematics.two_pole_low_pass((habits.chest_share + extra) * turned, habits.trunk_time, rate)
        share = habits.pelvis_share + 0.3 * max(0.0, extra)
        chest_follow = _soft_clip(chest, _CHEST_LIMIT)
        hips = kinematics.two_pole_low_pass(share * turned, 1.4 * habits.trunk_time, rate)
        pelvis_follow = _soft_clip(hips, _PELVIS_LIMIT)
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


def _soft_clip(values: np.ndarray, limit: float) -> np.ndarray:
    """Clip without a corner: straight up to 80 % of the limit."""
    size = np.abs(values)
    begin = 0.8 * limit
    soft = begin + 0.2 * limit * np.tanh((size - begin) / (0.2 * limit))
    return np.where(size > begin, np.sign(values) * soft, values)


_ARM_LIMIT = (0.95, 0.995)
_HANGING = 0.96
_OUTSIDE_SHOULDER = 0.032  # of the stature
_CARRY_AFTER = 0.75
_BACK_WITHIN = 0.8
_FULL_HUMP = 0.7  # metres of way

# Seconds that a nudged object slides.
_SLIDE_TIME = 0.15
# Seconds in which a door is opened.
_OPENING_TIME = 1.0
# Seconds in which the hands meet for a hand-over.
MEETING_TIME = 0.5
# Seconds in which the object goes from hand to hand.
HANDING_TIME = 0.6
_DOOR_WIDTH_HALF = float(cast(tuple[float, float, float], DOOR.half_extents)[0])


@dataclass(frozen=True)
class Arms:
    """Joints of both arms; index 1 is the side.

    Attributes:
        hinge: Unit normal of the arm plane: the elbow's axis, pointing left at neutral.
    """

    elbow: Sides
    wrist: Sides
    hinge: Sides


def move_wrists(plan: Plan, trunk: Trunk, sway: Sway, times: np.ndarray) -> Sides:
    """Return where the wrists are meant to be: waiting, reaching, carrying. Commands are applied in time order."""
    manner = plan.person.manner
    rest = [_resting_wrist(plan, trunk, sway, hand) for hand in (0, 1)]
    carry = [_offset_from_shoulder(plan, trunk, hand, plan.preset.carry_pose) for hand in (0, 1)]
    wrists = [waiting.copy() for waiting in rest]
    for reach in plan.reaches:
        hand, other = reach.hand, 1 - reach.hand
        if reach.handed_over is not None:
            # Both hands meet before the chest; one leaves, the other carries on.
            middle = 0.5 * (trunk.shoulders[0] + trunk.shoulders[1])
            stature = plan.person.body.stature
            for side in (0, 1):
                offset = np.array([0.08 if side == 0 else -0.08, -0.18 * stature, 0.21 * stature])
                meeting = middle + kinematics.turn(trunk.yaws[3], 0.0, offset)
                kinematics.blend(wrists[side], times, reach.handed_over, MEETING_TIME, meeting)
            handed = reach.handed_over + MEETING_TIME + HANDING_TIME
            kinematics.blend(wrists[other], times, handed, _BACK_WITHIN, rest[other])
            kinematics.blend(wrists[hand], times, handed, 0.5, carry[hand])
        _reach(manner, wrists[hand], reach, np.zeros(3), times)
        if reach.carries:
            kinematics.blend(wrists[hand], times, reach.event, _CARRY_AFTER, carry[hand])
        else:
            # Stay a little, with what slides or turns, and go back.
            if reach.slide is not None or reach.opening:
                first = int(np.searchsorted(times, reach.event))
                wrists[hand][first:] = moved_along(reach, reach.grasp.wrist, times[first:])
            if np.isfinite(reach.dwell):
                kinematics.blend(wrists[hand], times, reach.event + reach.dwell, _BACK_WITHIN, rest[hand])
        if reach.second_hand:
            # The other hand joins after the lift, some way beside the first, and helps to put down.
            beside = np.array([(1.0 if hand == 1 else -1.0) * reach.second_hand, 0.0, 0.0])
            if reach.action == "pick":
                joined = carry[hand] + kinematics.turn(trunk.yaws[3], 0.0, beside)
                kinematics.blend(wrists[other], times, reach.event + 0.2, _CARRY_AFTER - 0.2, joined)
            else:
                _reach(manner, wrists[other], reach, kinematics.turn(reach.base.heading, 0.0, beside), times)
                kinematics.blend(wrists[other], times, reach.event + reach.dwell, _BACK_WITHIN, rest[other])
    return np.stack(wrists, axis=1)


def _reach(manner: Manner, wrist: np.ndarray, reach: Reach, beside: np.ndarray, times: np.ndarray) -> None:
    """Move a wrist to the grasp, on a path that bulges up and forward: past the table's edge and the own shoulder."""
    duration = reach.contact - reach.reach_start
    target = reach.grasp.wrist + beside
    # Short reaches bulge less.
    way = float(np.linalg.norm(target - wrist[min(int(np.searchsorted(times, reach.reach_start)), times.size - 1)]))
    kinematics.blend(wrist, times, reach.reach_start, duration, target, shape=manner.reach)
    up, forward = manner.hump
    hump = min(1.0, way / _FULL_HUMP) * (up * kinematics.UP + forward * reach.base.forward)
    kinematics.add_bump(wrist, times, reach.reach_start, duration, hump)


def moved_along(reach: Reach, point: Float[np.ndarray, "3"], times: Signal) -> Points:
    """Return where a point fixed to a nudged or hinged object is after the event."""
    if reach.slide is not None:
        return point + kinematics.minimum_jerk((times - reach.event) / _SLIDE_TIME)[:, None] * reach.slide
    axis = reach.centre + kinematics.turn(reach.yaw, 0.0, np.array([_DOOR_WIDTH_HALF, 0.0, 0.0]))
    return axis + kinematics.turn(opened(reach, times), 0.0, point - axis)


def opened(reach: Reach, times: Signal) -> Signal:
    """Return the angle of a door that is pulled towards the person, radians."""
    return -reach.opening * kinematics.minimum_jerk((times - reach.event) / _OPENING_TIME)


def _resting_wrist(plan: Plan, trunk: Trunk, sway: Sway, hand: int) -> np.ndarray:
    if plan.preset.work_pose is not None:
        return _offset_from_shoulder(plan, trunk, hand, plan.preset.work_pose) + sway.hands[:, hand]
    body = plan.person.body
    side = 1.0 if hand == 0 else -1.0
    outside = _OUTSIDE_SHOULDER * body.stature
    length = np.sqrt((_HANGING * body.arm) ** 2 - outside**2)
    angle = side * plan.person.habits.arm_swing * sway.arm_swing
    hanging = np.stack([np.full(angle.size, side * outside), -length * np.cos(angle), length * np.sin(angle)], axis=-1)
    return trunk.shoulders[hand] + kinematics.turn(trunk.yaws[3], 0.0, hanging) + sway.hands[:, hand]


def _offset_from_shoulder(plan: Plan, trunk: Trunk, hand: int, offset: tuple[float, float, float]) -> np.ndarray:
    """Return a place relative to the shoulder: outwards, up, forward; fractions of the stature."""
    side = 1.0 if hand == 0 else -1.0
    scaled = plan.person.body.stature * np.array([side * offset[0], offset[1], offset[2]])
    return trunk.shoulders[hand] + kinematics.turn(trunk.yaws[3], 0.0, scaled)


def elbow_poles(flare: float, trunk: Trunk, wrists: Sides) -> Sides:
    """Return where the elbows point, in the chest's frame; follows the direction of the arm.

    A fixed pole would be antiparallel to an arm that reaches up and forward, and the elbow would flip. Upward is the
    chest's: in a deep bend, the world's would leave the pole antiparallel to an arm that hangs in front of the face.
    """
    chest_up = kinematics.turn(trunk.yaws[3], trunk.pitches[3], np.array([0.0, 1.0, 0.0]))
    poles = []
    for hand in (0, 1):
        side = 1.0 if hand == 0 else -1.0
        upward = np.sum(kinematics.unit(wrists[:, hand] - trunk.shoulders[hand]) * chest_up, axis=-1)
        raised = kinematics.minimum_jerk((upward + 0.3) / 0.8)
        outward = side * (flare + 0.6 * raised)
        poles.append(np.stack([outward, np.full(upward.size, -0.85), -0.65 * (1.0 - raised)], axis=-1))
    return np.stack(poles, axis=1)


def pose_arms(body: Body, flare: float, trunk: Trunk, wrists: Sides, poles: Sides | None = None) -> Arms:
    """Find the elbows by two-bone kinematics.

    Args:
        body: Bone lengths.
        flare: How far the elbows stand out.
        trunk: Shoulders and chest.
        wrists: Wanted wrists.
        poles: Directions in which the elbows point, chest frame; :func:`elbow_poles` if None.
    """
    elbows = []
    reached = []
    hinges = []
    poles = elbow_poles(flare, trunk, wrists) if poles is None else poles
    for hand in (0, 1):
        shoulder = trunk.shoulders[hand]
        pole = kinematics.turn(trunk.yaws[3], trunk.pitches[3], poles[:, hand])
        elbow, wrist = kinematics.two_bone(shoulder, wrists[:, hand], (body.upper_arm, body.forearm), pole, _ARM_LIMIT)
        elbows.append(elbow)
        reached.append(wrist)
        hinges.append(kinematics.unit(np.cross(wrist - elbow, elbow - shoulder)))
    return Arms(np.stack(elbows, axis=1), np.stack(reached, axis=1), np.stack(hinges, axis=1))


def turn_hands(plan: Plan, arms: Arms, times: np.ndarray) -> Float[np.ndarray, "n 2 3 3"]:
    """Return world from hand: y from wrist to finger base along the forearm, turned into the grasp around an event."""
    frames = []
    for hand in (0, 1):
        neutral = np.stack([arms.hinge[:, hand], kinematics.unit(arms.wrist[:, hand] - arms.elbow[:, hand])], axis=1)
        axes = neutral.copy()
        for reach in plan.reaches:
            if reach.hand != hand:
                continue
            begin = reach.reach_start
            kinematics.blend(axes, times, begin, reach.contact - begin, reach.grasp.hand.T[:2])
            leave = reach.event + (0.0 if reach.carries else reach.dwell)
            if np.isfinite(leave):
                kinematics.blend(axes, times, leave, _BACK_WITHIN, neutral)
        frames.append(kinematics.frame_of_bone(axes[:, 1], axes[:, 0]))
    return np.stack(frames, axis=1)
