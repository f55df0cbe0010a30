"""Plausible: whether a body could move so at all, and the numbers that decide it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import TOES, WRISTS, Joint
from prbench.metrics import batch, footing, initial_state, posture
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
        "given_start": lambda pair, _: initial_state.start_offset(pair),
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
    return numbers | footing.footing_numbers(pair, constants) | posture.posture_numbers(pair)


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
