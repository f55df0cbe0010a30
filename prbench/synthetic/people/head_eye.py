"""Head and eyes that follow one list of fixations (docs/specification/synthetic-recordings.md#eye-head-trunk)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.gaze_plan import GazePlan, Look
from prbench.synthetic.people.kinematics import direction, minimum_jerk, smooth, wobble, wrap, yaw_and_pitch
from prbench.synthetic.people.person import Habits
from prbench.synthetic.people.presets import Preset

_HEAD_YAW = np.deg2rad(100.0)
_HEAD_UP = np.deg2rad(-34.0)
_HEAD_DOWN = np.deg2rad(66.0)
_FASTEST_HEAD = np.deg2rad(270.0)
_FASTEST_PURSUIT = np.deg2rad(120.0)
_EYE_YAW = np.deg2rad(45.0)
_EYE_UP = np.deg2rad(-32.0)
_EYE_DOWN = np.deg2rad(40.0)
_LONGEST_SACCADE = 0.3  # s
_SHORT_FILL = 0.35  # s; the head does not follow shorter looks
_SHORT_GOAL_LOOK = 0.5


@dataclass(frozen=True)
class Head:
    """True head orientation, radians: yaw in the world (not wrapped) and pitch (> 0 down)."""

    yaw: Float[np.ndarray, " n"]
    pitch: Float[np.ndarray, " n"]


@dataclass
class _Command:
    """One head movement: towards a point until the fixation ends, then frozen relative to the heading."""

    first: int
    frozen: int
    start: float
    duration: float
    target: Float[np.ndarray, "m 2"]
    """Yaw relative to the heading, and pitch, for frames ``first`` to ``frozen``."""


def move_head(
    preset: Preset,
    habits: Habits,
    gaze: GazePlan,
    heading: Float[np.ndarray, " n"],
    eye: Float[np.ndarray, "n 3"],
    times: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Head:
    """Return the head's orientation over time.

    Args:
        preset: Gains.
        habits: Gains, lag and eye-only range of the person.
        gaze: Fixations.
        heading: Of the base, radians, unwrapped.
        eye: About where the eyes are.
        times: Frame times, seconds.
        rng: For the tremor.
    """
    rate = 1.0 / (times[1] - times[0])
    commands, channel = _plan_commands(preset, habits, gaze.looks, heading, eye, times)
    for _ in range(6):
        speed = np.abs(np.gradient(heading + channel[:, 0], times))
        fast = times[speed > _FASTEST_HEAD]
        slowed = [
            command
            for command in commands
            if _any_inside(fast, command.start - 0.02, command.start + command.duration + 0.02)
        ]
        if not slowed:
            break
        for command in slowed:
            command.duration *= 1.35
        channel = _follow(commands, times)
    tremor = np.stack([wobble(times, np.deg2rad(0.5), 0.2, 1.5, rng) for _ in range(2)], axis=-1)
    steady = smooth(channel, 0.030, rate) + tremor
    return Head(heading + steady[:, 0], steady[:, 1])


def _any_inside(sorted_times: np.ndarray, begin: float, end: float) -> bool:
    first, last = np.searchsorted(sorted_times, [begin, end])
    return bool(last > first)


def _plan_commands(
    preset: Preset,
    habits: Habits,
    looks: tuple[Look, ...],
    heading: np.ndarray,
    eye: np.ndarray,
    times: np.ndarray,
) -> tuple[list[_Command], np.ndarray]:
    channel = np.zeros((times.size, 2))
    turn_rate = np.abs(np.gradient(heading, times))
    commands: list[_Command] = []
    frame_time = float(times[1] - times[0])
    for look in looks:
        start = look.start + habits.head_lag
        first, frozen = np.searchsorted(times, [start, look.end])
        if first >= times.size:
            break
        frozen = max(int(frozen), int(first) + 1)
        relative = _relative_direction(
            look.point, eye[first:frozen], heading[first:frozen], channel[first, 0], frame_time
        )
        present = channel[first]
        away = np.hypot(*(relative[0] - present))
        length = look.end - look.start
        if not look.is_goal and (length < _SHORT_FILL or away < habits.eye_only_range + np.deg2rad(6.0)):
            continue
        target = relative * _gains(preset, habits, look)
        amplitude = float(np.hypot(*(target[0] - present)))
        if commands and start - commands[-1].start < 0.7:
            amplitude = max(amplitude, float(np.hypot(*(target[0] - commands[-1].target[0]))))
        degrees = np.rad2deg(amplitude)
        # A head that turns together with the body takes longer, up to 1.6 times.
        slower = 1.0 + min(float(np.rad2deg(turn_rate[first])) / 250.0, 0.6)
        duration = max(0.28 + 0.0048 * degrees, degrees / 117.0) * slower
        commands.append(_Command(int(first), frozen, start, duration, target))
        _obey(channel, commands[-1], times)
    return commands, channel


def _relative_direction(
    point: np.ndarray, eye: np.ndarray, heading: np.ndarray, present: float, frame_time: float
) -> np.ndarray:
    """Return the direction of a point against the heading; wrapped once, at the first frame, then continuous.

    The bearing of a point right below the eyes swings around with every step; the head does not.
    """
    yaw, pitch = yaw_and_pitch(point - eye)
    relative = np.unwrap(yaw) - heading
    relative += wrap(relative[0] - 0.3 * present) + 0.3 * present - relative[0]
    step = _FASTEST_PURSUIT * frame_time
    relative[1:] = relative[0] + np.cumsum(np.clip(np.diff(relative), -step, step))
    return np.stack([np.clip(relative, -_HEAD_YAW, _HEAD_YAW), np.clip(pitch, _HEAD_UP, _HEAD_DOWN)], axis=-1)


def _gains(preset: Preset, habits: Habits, look: Look) -> np.ndarray:
    goal = preset.head_gain * np.array([habits.goal_gain, habits.goal_gain_vertical])
    fill = np.array([habits.fill_gain, habits.fill_gain_vertical])
    if not look.is_goal:
        return fill
    return goal if look.end - look.start >= _SHORT_GOAL_LOOK else 0.5 * (goal + fill)


def _follow(commands: list[_Command], times: np.ndarray) -> np.ndarray:
    channel = np.zeros((times.size, 2))
    for command in commands:
        _obey(channel, command, times)
    return channel


def _obey(channel: np.ndarray, command: _Command, times: np.ndarray) -> None:
    first = command.first
    last = int(np.searchsorted(times, command.start + command.duration))
    until = min(max(last, command.frozen), times.size)
    target = np.empty((until - first, 2))
    count = min(len(command.target), until - first)
    target[:count] = command.target[:count]
    target[count:] = command.target[-1]
    progress = minimum_jerk((times[first:until] - command.start) / command.duration)[:, None]
    channel[first:until] = np.where(progress < 1.0, channel[first:until] * (1.0 - progress) + progress * target, target)
    channel[until:] = command.target[-1]


def move_eyes(
    looks: tuple[Look, ...],
    head: Head,
    eye: Float[np.ndarray, "n 3"],
    times: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    """Return the unit gaze directions: saccades, fixation of points in the world, limits of the eye in the head.

    Args:
        looks: Fixations without gaps.
        head: True head orientation.
        eye: True eye positions.
        times: Frame times, seconds.
        rng: For the drift during fixation.
    """
    drift = np.stack([wobble(times, np.deg2rad(0.3), 0.3, 3.0, rng) for _ in range(2)], axis=-1)
    gaze = np.stack([head.yaw, head.pitch], axis=-1)
    low = np.stack([head.yaw - _EYE_YAW, head.pitch + _EYE_UP], axis=-1)
    high = np.stack([head.yaw + _EYE_YAW, head.pitch + _EYE_DOWN], axis=-1)
    for look in looks:
        first, last = np.searchsorted(times, [look.start, look.end + _LONGEST_SACCADE])
        if first >= times.size:
            break
        yaw, pitch = yaw_and_pitch(look.point - eye[first:last])
        yaw = np.unwrap(yaw)
        yaw += wrap(yaw[0] - head.yaw[first]) + head.yaw[first] - yaw[0]
        target = np.stack([yaw, pitch], axis=-1) + drift[first:last]
        amplitude = float(np.rad2deg(np.hypot(*(target[0] - gaze[first]))))
        # 21 ms and 2.2 ms a degree: the duration of saccades grows linearly with their amplitude.
        saccade = 0.021 + 0.0022 * amplitude
        progress = minimum_jerk((times[first:last] - look.start) / saccade)[:, None]
        blended = np.where(progress < 1.0, gaze[first:last] + progress * (target - gaze[first:last]), target)
        gaze[first:last] = np.clip(blended, low[first:last], high[first:last])
    return direction(gaze[:, 0], gaze[:, 1])
