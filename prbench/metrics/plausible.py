"""Plausible: whether a body could move so at all, and the numbers that decide it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import TOES, WRISTS, Joint
from prbench.metrics import batch, footing, pose_errors
from prbench.metrics.batch import ScoringPair
from prbench.metrics.bone_length_change import arm_shares, body_length, bone_length_change
from prbench.metrics.foot_skating import Fps, slow_slides
from prbench.metrics.registry import MetricFamily, MetricValues, detail, headline
from prbench.protocol.manifests import Limit, MetricConstants

Numbers = Float[np.ndarray, " n"]

_TRUNK = (Joint.PELVIS, Joint.SPINE3)
_FEET = (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE, *TOES)


def largest_speed(motion: batch.MotionBatch, fps: Fps) -> Numbers:
    """Largest speed of a joint from one frame to the next, m/s (docs/specification/metrics.md#largest-speed).

    Args:
        motion: Metres, any frame, two frames or more.
        fps: Frames per second.
    """
    motion.require_frames(2)
    return _largest_difference(motion, 1) * np.asarray(fps)


def largest_acceleration(motion: batch.MotionBatch, fps: Fps, joints: Sequence[int] = tuple(Joint)) -> Numbers:
    """Largest norm of the second difference over frames and joints times fps², m/s²; 0 for fewer than three frames."""
    return _largest_difference(motion, 2, joints) * np.asarray(fps) ** 2


def largest_jerk(motion: batch.MotionBatch, fps: Fps) -> Numbers:
    """Largest norm of the third difference over frames and joints times fps³, m/s³; 0 for fewer than four frames.

    Source: docs/specification/metrics.md#largest-jerk.
    """
    return _largest_difference(motion, 3) * np.asarray(fps) ** 3


def _largest_difference(motion: batch.MotionBatch, order: int, joints: Sequence[int] = tuple(Joint)) -> Numbers:
    # The norm of the difference that starts at each row; 0 for the last rows of a sequence.
    norms = np.zeros((len(joints), len(motion.values)))
    difference = np.diff(motion.columns[list(joints)], n=order, axis=-1)
    norms[:, :-order] = np.sqrt(difference[:, 0] ** 2 + difference[:, 1] ** 2 + difference[:, 2] ** 2)
    for k in range(order):
        norms[:, motion.last - k] = 0.0
    return np.maximum.reduceat(norms.max(axis=0), motion.first)


def floating(motion: batch.MotionBatch) -> Numbers:
    """Greatest height of the lower foot: max over frames of the lowest ankle or toe, at least 0; metres.

    Args:
        motion: Canonical frame, metres.
    """
    return np.maximum(np.maximum.reduceat(motion.columns[list(_FEET), 1].min(axis=0), motion.first), 0.0)


def penetration(motion: batch.MotionBatch) -> Numbers:
    """Greatest depth of a joint below the floor in any frame, at least 0; metres.

    Args:
        motion: Canonical frame, metres.
    """
    return np.maximum(-np.minimum.reduceat(motion.columns[:, 1].min(axis=0), motion.first), 0.0)


def lowest_pelvis(motion: batch.MotionBatch) -> Numbers:
    """Smallest height of the pelvis above the floor in any frame, metres.

    Args:
        motion: Canonical frame, metres.
    """
    return np.minimum.reduceat(motion.columns[Joint.PELVIS, 1], motion.first)


def largest_trunk_tilt(motion: batch.MotionBatch) -> Numbers:
    """Largest angle between the line from pelvis to neck and the vertical in any frame, degrees.

    Args:
        motion: Any frame with Y up, metres.

    Returns:
        0 for an upright trunk, 90 for a level one, 180 for one upside down; 0 where neck and pelvis coincide.
    """
    trunk = motion.columns[Joint.NECK] - motion.columns[Joint.PELVIS]
    tilt = np.rad2deg(np.arctan2(np.sqrt(trunk[0] ** 2 + trunk[2] ** 2), trunk[1]))
    return np.maximum.reduceat(tilt, motion.first)


Measure = Callable[[batch.ScoringPair, MetricConstants], Numbers]


def _bone_change(pair: batch.ScoringPair, poses: Float[np.ndarray, "n 22 3"] | None = None) -> Numbers:
    change, missing = bone_length_change(pair.predicted, poses)
    return np.where(missing, np.inf, change)


# Flag of a motion that was given no pose: its bones are compared with those of its own first frame.
OWN_FIRST_FRAME = "own_first_frame"
# Measures of the motion alone, by the name under which the protocol limits them.
MEASURES: Mapping[str, Measure] = MappingProxyType(
    {
        "lowest_pelvis": lambda pair, _: lowest_pelvis(pair.predicted),
        "trunk_tilt": lambda pair, _: largest_trunk_tilt(pair.predicted),
        "floating": lambda pair, _: floating(pair.predicted),
        "penetration": lambda pair, _: penetration(pair.predicted),
        "bone_change": lambda pair, _: _bone_change(pair),
        "given_bones": lambda pair, _: _bone_change(pair, pair.first_poses),
        "given_start": lambda pair, _: pose_errors.start_offset(pair),
        "smallest_body": lambda pair, _: body_length(pair.predicted),
        "largest_body": lambda pair, _: body_length(pair.predicted),
        "shortest_arm": lambda pair, _: arm_shares(pair.predicted).min(axis=0),
        "longest_arm": lambda pair, _: arm_shares(pair.predicted).max(axis=0),
        "slow_slides": lambda pair, constants: slow_slides(pair.predicted, pair.targets.fps, constants),
        "jerk": lambda pair, _: largest_jerk(pair.predicted, pair.targets.fps),
        "acceleration": lambda pair, _: largest_acceleration(pair.predicted, pair.targets.fps),
        "trunk_acceleration": lambda pair, _: largest_acceleration(pair.predicted, pair.targets.fps, _TRUNK),
        "wrist_acceleration": lambda pair, _: largest_acceleration(pair.predicted, pair.targets.fps, WRISTS),
        "speed": lambda pair, _: largest_speed(pair.predicted, pair.targets.fps),
    }
)


def body_numbers(pair: batch.ScoringPair, constants: MetricConstants) -> dict[str, Numbers]:
    """Measure what decides whether the predicted motions are plausible (docs/specification/metrics.md#plausible).

    Args:
        pair: Predicted motions, canonical frame, metres, two frames or more, with their goals.
        constants: Thresholds of the protocol: heights and speeds that count as contact, a slide or a seat.

    Returns:
        One number a sequence by the name under which the protocol limits it.
    """
    numbers = {name: measure(pair, constants) for name, measure in MEASURES.items()}
    return numbers | footing.footing_numbers(pair, constants) | posture_numbers(pair)


def broken_limits(
    numbers: Mapping[str, Numbers], limits: Mapping[str, Limit], tolerance: float
) -> dict[str, Bool[np.ndarray, " n"]]:
    """Return which motions break which limit; a motion is plausible if it breaks none.

    Args:
        numbers: Measurements of :func:`body_numbers`.
        limits: The limits by the name of their measure.
        tolerance: A number this close to its limit, in its own unit, keeps it.

    Returns:
        Masks by the flag that says what is broken.
    """
    broken: dict[str, np.ndarray] = {}
    for name, limit in limits.items():
        beyond = numbers[name] - limit.value if limit.bound == "most" else limit.value - numbers[name]
        broken[limit.flag] = (beyond > tolerance) | broken.get(limit.flag, np.zeros(len(beyond), dtype=bool))
    return broken


def _compute(pair: batch.ScoringPair, constants: MetricConstants) -> tuple[MetricValues, ...]:
    numbers = body_numbers(pair, constants)
    judged = []
    for judge in ("plausible", "plausible_3"):
        broken = broken_limits(numbers, getattr(constants, judge), constants.threshold_tolerance)
        kept = 1.0 - np.logical_or.reduce(list(broken.values()))
        if judge == "plausible" and not pair.targets.pose_given:
            broken[OWN_FIRST_FRAME] = np.ones(len(kept), dtype=bool)
        judged.append(MetricValues(judge, kept, broken))
    names = ("floating", "penetration", "slow_slides", "largest_jerk", "largest_speed")
    return (*judged, *(MetricValues(name, numbers[name.removeprefix("largest_")], {}) for name in names))


_METRICS = (
    headline("plausible", "Plausible", "rate", 8, higher_is_better=True, ranked=False),
    # The judge of the protocol before, for this one version.
    headline("plausible_3", "Plausible (version 3)", "rate", 9, higher_is_better=True, ranked=False, compared=False),
    detail("floating", "Floating", "m", 21, higher_is_better=False),
    detail("penetration", "Penetration", "m", 22, higher_is_better=False),
    detail("slow_slides", "Slow slides", "ratio", 23, higher_is_better=False),
    # Of jerk and speed, less is no merit within the limits: a body that stands still has none.
    detail("largest_jerk", "Largest jerk", "m/s³", 24, higher_is_better=None),
    detail("largest_speed", "Largest speed", "m/s", 25, higher_is_better=None),
)
FAMILY = MetricFamily(_METRICS, _compute)


# Name of each bend: pairs of bones, (from, to) each, between which it is the largest angle; 0 for straight ones.
_Bone = tuple[Joint, Joint]
_HIPS = (Joint.RIGHT_HIP, Joint.LEFT_HIP)
_SHOULDERS = (Joint.RIGHT_SHOULDER, Joint.LEFT_SHOULDER)
_FOOT_BONES = ((Joint.LEFT_ANKLE, Joint.LEFT_FOOT), (Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT))


def _on_each_side(*joints: str) -> tuple[tuple[_Bone, _Bone], ...]:
    """Return the bend between the bones from the first to the second and from the third to the fourth joint."""
    sides = [[Joint[name.format(side)] for name in joints] for side in ("LEFT", "RIGHT")]
    return tuple(((first, second), (third, fourth)) for first, second, third, fourth in sides)


_BENDS: dict[str, tuple[tuple[_Bone, _Bone], ...]] = {
    "knee": _on_each_side("{}_HIP", "{}_KNEE", "{}_KNEE", "{}_ANKLE"),
    "elbow": _on_each_side("{}_SHOULDER", "{}_ELBOW", "{}_ELBOW", "{}_WRIST"),
    "ankle": _on_each_side("{}_KNEE", "{}_ANKLE", "{}_ANKLE", "{}_FOOT"),
    "hip": _on_each_side("SPINE1", "PELVIS", "{}_HIP", "{}_KNEE"),
    "spine": (((Joint.PELVIS, Joint.SPINE1), (Joint.SPINE3, Joint.NECK)),),
    "neck": (((Joint.SPINE3, Joint.NECK), (Joint.NECK, Joint.HEAD)),),
}


def posture_numbers(pair: ScoringPair) -> dict[str, Float[np.ndarray, " n"]]:
    """Measure the postures of each predicted motion (docs/specification/metrics.md#posture).

    Args:
        pair: Predicted motions, canonical frame, metres, two frames or more, with their goals.

    Returns:
        * ``knee``, ``elbow``, ``ankle``, ``hip``, ``spine``, ``neck``: largest bend, degrees; 0 is straight, and a
          neck at rest has 0.
        * ``toe_out``: largest turn of a foot against the hips about the vertical, degrees.
        * ``twist``: largest turn of the shoulders against the hips about the trunk, degrees; ``twisting``: its largest
          speed, degrees a second.
        * ``turning``, ``bowing``, ``nodding``: largest speed at which hips or shoulders turn about the vertical, and at
          which the lines from pelvis to neck and from neck to head turn, degrees a second.
        * ``tilt_at_goal``: tilt of the trunk, degrees, in the frame in which a wrist is nearest to a goal that is
          higher than the knees; 0 for lower goals.
        * ``head_under_goal``: height of the goal above the head in that frame, metres; less than 0 for lower goals.
    """
    motion = pair.predicted
    joints = motion.columns

    def largest(values: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " n"]:
        return np.maximum.reduceat(values, motion.first)

    found = {}
    for name, bones in _BENDS.items():
        bends = [_angle(joints[b] - joints[a], joints[d] - joints[c]) for (a, b), (c, d) in bones]
        found[name] = largest(np.max(bends, axis=0))
    lines = [joints[left] - joints[right] for right, left in (_HIPS, _SHOULDERS)]
    left_x, _, left_z = lines[0]
    ahead = np.stack([-left_z, np.zeros_like(left_x), left_x])
    feet = [joints[toe] - joints[ankle] for ankle, toe in _FOOT_BONES]
    level = np.array([[1.0], [0.0], [1.0]])
    found["toe_out"] = largest(np.max([_angle(ahead, foot * level) for foot in feet], axis=0))
    trunk = joints[Joint.NECK] - joints[Joint.PELVIS]
    # The parts of both lines across the trunk: what is left of their angle is the turn about it.
    squared = np.maximum((trunk * trunk).sum(axis=0), 1e-12)
    across = [line - (line * trunk).sum(axis=0) / squared * trunk for line in lines]
    twist = _angle(*across)
    found["twist"] = largest(twist)
    found["twisting"] = _fastest(np.abs(np.diff(twist)), pair)
    speeds = [_fastest(_angle((line * level)[:, :-1], (line * level)[:, 1:]), pair) for line in lines]
    found["turning"] = np.max(speeds, axis=0)
    found["bowing"] = _fastest(_angle(trunk[:, :-1], trunk[:, 1:]), pair)
    head = joints[Joint.HEAD] - joints[Joint.NECK]
    found["nodding"] = _fastest(_angle(head[:, :-1], head[:, 1:]), pair)
    found["neck"] -= pair.targets.head_tilt_deg
    # The frame in which a wrist is nearest to the goal.
    goal = pair.targets.goal_location.T[:, motion.sequence_of_row]
    distance = np.sqrt(((joints[list(WRISTS)] - goal) ** 2).sum(axis=1)).min(axis=0)
    nearest = np.array([np.argmin(part) for part in np.split(distance, motion.first[1:])]) + motion.first
    up = np.array([[0.0], [1.0], [0.0]])
    tilt = _angle(trunk[:, nearest], np.broadcast_to(up, trunk[:, nearest].shape))
    height = pair.targets.goal_location[:, 1]
    knees = joints[[Joint.LEFT_KNEE, Joint.RIGHT_KNEE], 1].mean(axis=0)[nearest]
    found["tilt_at_goal"] = np.where(height > knees, tilt, 0.0)
    found["head_under_goal"] = height - joints[Joint.HEAD, 1, nearest]
    return found


def _angle(first: Float[np.ndarray, "3 frames"], second: Float[np.ndarray, "3 frames"]) -> Float[np.ndarray, " frames"]:
    """Angle between two vectors, degrees; 0 where one has no length."""
    cross = np.cross(first, second, axis=0)
    return np.rad2deg(np.arctan2(np.sqrt((cross * cross).sum(axis=0)), (first * second).sum(axis=0)))


def _fastest(turns: Float[np.ndarray, " frames_but_one"], pair: ScoringPair) -> Float[np.ndarray, " n"]:
    """Return the largest turn from a frame to the next one of the same sequence, degrees a second."""
    motion = pair.predicted
    turn = np.append(turns, 0.0)
    turn[motion.last] = 0.0
    return np.maximum.reduceat(turn, motion.first) * pair.targets.fps_of_sequence
