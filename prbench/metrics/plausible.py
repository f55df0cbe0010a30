"""Plausible: whether a body could move so at all, and the numbers that decide it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import TOES, Joint
from prbench.metrics.batch import MotionBatch, ScoringPair
from prbench.metrics.bone_length_change import bone_length_change
from prbench.metrics.foot_skating import Fps, slow_slides
from prbench.metrics.registry import MetricFamily, MetricValues, detail, headline
from prbench.protocol.manifests import MetricConstants

_FEET = (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE, *TOES)


@dataclass(frozen=True, eq=False)
class BodyNumbers:
    """What decides whether each motion is plausible (docs/specification/metrics.md#plausible).

    Attributes:
        lowest_pelvis: Metres above the floor.
        trunk_tilt: Largest, degrees from the vertical.
        floating: Greatest height of the lower foot, metres.
        penetration: Greatest depth below the floor, metres.
        bone_change: Largest relative change of a bone's length; infinite where frame 0 has a bone without length.
        slow_slides: Share of frame transitions.
        jerk: Largest, m/s³.
        speed: Largest of a joint, m/s.
    """

    lowest_pelvis: Float[np.ndarray, " n"]
    trunk_tilt: Float[np.ndarray, " n"]
    floating: Float[np.ndarray, " n"]
    penetration: Float[np.ndarray, " n"]
    bone_change: Float[np.ndarray, " n"]
    slow_slides: Float[np.ndarray, " n"]
    jerk: Float[np.ndarray, " n"]
    speed: Float[np.ndarray, " n"]


def largest_speed(motion: MotionBatch, fps: Fps) -> Float[np.ndarray, " n"]:
    """Largest speed of a joint from one frame to the next, m/s (docs/specification/metrics.md#largest-speed).

    Args:
        motion: Metres, any frame, two frames or more.
        fps: Frames per second.
    """
    motion.require_frames(2)
    step = np.diff(motion.columns, axis=-1)
    way = np.zeros(len(motion.values))
    way[:-1] = np.sqrt(step[:, 0] ** 2 + step[:, 1] ** 2 + step[:, 2] ** 2).max(axis=0)
    way[motion.last] = 0.0  # the step from one sequence to the next is none
    return np.maximum.reduceat(way, motion.first) * np.asarray(fps)


def largest_jerk(motion: MotionBatch, fps: Fps) -> Float[np.ndarray, " n"]:
    """Largest norm of the third difference over frames and joints times fps³, m/s³; 0 for fewer than four frames.

    Source: docs/specification/metrics.md#largest-jerk.
    """
    # The norm of the third difference that starts at each row; 0 for the last three rows of a sequence.
    norms = np.zeros((len(motion.columns), len(motion.values)))
    third = np.diff(motion.columns, n=3, axis=-1)
    norms[:, :-3] = np.sqrt(third[:, 0] ** 2 + third[:, 1] ** 2 + third[:, 2] ** 2)
    for k in range(3):
        norms[:, motion.last - k] = 0.0
    return np.maximum.reduceat(norms.max(axis=0), motion.first) * np.asarray(fps) ** 3


def floating(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Greatest height of the lower foot: max over frames of the lowest ankle or toe, at least 0; metres.

    Args:
        motion: Canonical frame, metres.
    """
    lowest_foot = motion.columns[list(_FEET), 1].min(axis=0)
    return np.maximum(np.maximum.reduceat(lowest_foot, motion.first), 0.0)


def penetration(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Greatest depth of a joint below the floor in any frame, at least 0; metres.

    Args:
        motion: Canonical frame, metres.
    """
    lowest_joint = motion.columns[:, 1].min(axis=0)
    return np.maximum(-np.minimum.reduceat(lowest_joint, motion.first), 0.0)


def lowest_pelvis(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Smallest height of the pelvis above the floor in any frame, metres.

    Args:
        motion: Canonical frame, metres.
    """
    return np.minimum.reduceat(motion.columns[Joint.PELVIS, 1], motion.first)


def largest_trunk_tilt(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Largest angle between the line from pelvis to neck and the vertical in any frame, degrees.

    Args:
        motion: Any frame with Y up, metres.

    Returns:
        0 for an upright trunk, 90 for a level one, 180 for one upside down; 0 where neck and pelvis coincide.
    """
    trunk = motion.columns[Joint.NECK] - motion.columns[Joint.PELVIS]
    tilt = np.rad2deg(np.arctan2(np.sqrt(trunk[0] ** 2 + trunk[2] ** 2), trunk[1]))
    return np.maximum.reduceat(tilt, motion.first)


def body_numbers(motion: MotionBatch, fps: Fps, constants: MetricConstants) -> BodyNumbers:
    """Measure everything that decides whether motions are plausible.

    Args:
        motion: Canonical frame, metres, two frames or more.
        fps: Frames per second.
        constants: Thresholds of the protocol: heights and speeds that count as a slide.
    """
    change, missing = bone_length_change(motion)
    return BodyNumbers(
        lowest_pelvis=lowest_pelvis(motion),
        trunk_tilt=largest_trunk_tilt(motion),
        floating=floating(motion),
        penetration=penetration(motion),
        bone_change=np.where(missing, np.inf, change),
        slow_slides=slow_slides(motion, fps, constants),
        jerk=largest_jerk(motion, fps),
        speed=largest_speed(motion, fps),
    )


def broken_limits(numbers: BodyNumbers, constants: MetricConstants) -> dict[str, Bool[np.ndarray, " n"]]:
    """Return which motions break which limit; a motion is plausible if it breaks none.

    Args:
        numbers: Measurements of :func:`body_numbers`.
        constants: The limits; a number within ``threshold_tolerance`` of its limit, in its own unit, keeps it.

    Returns:
        Masks by the flag that says what is broken.
    """
    tolerance = constants.threshold_tolerance
    too_low = numbers.lowest_pelvis < constants.lowest_pelvis - tolerance
    too_tilted = numbers.trunk_tilt > constants.largest_trunk_tilt_deg + tolerance
    return {
        "not_upright": too_low | too_tilted,
        "floating": numbers.floating > constants.largest_floating + tolerance,
        "below_the_floor": numbers.penetration > constants.largest_penetration + tolerance,
        "changing_bones": numbers.bone_change > constants.largest_bone_change + tolerance,
        "sliding_feet": numbers.slow_slides > constants.largest_slide_share + tolerance,
        "jerky": numbers.jerk > constants.largest_jerk + tolerance,
        "too_fast": numbers.speed > constants.largest_speed + tolerance,
    }


def plausible(motion: MotionBatch, fps: Fps, constants: MetricConstants) -> Float[np.ndarray, " n"]:
    """1 where a motion breaks no limit of the protocol, else 0 (docs/specification/metrics.md#plausible).

    Args:
        motion: Canonical frame, metres, two frames or more.
        fps: Frames per second.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
    """
    return _keeps_all(broken_limits(body_numbers(motion, fps, constants), constants))


def _keeps_all(broken: dict[str, np.ndarray]) -> Float[np.ndarray, " n"]:
    return 1.0 - np.logical_or.reduce(list(broken.values())).astype(np.float64)


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, ...]:
    numbers = body_numbers(pair.predicted, pair.targets.fps, constants)
    broken = broken_limits(numbers, constants)
    return (
        MetricValues("plausible", _keeps_all(broken), broken),
        MetricValues("floating", numbers.floating, {}),
        MetricValues("penetration", numbers.penetration, {}),
        MetricValues("slow_slides", numbers.slow_slides, {}),
        MetricValues("largest_jerk", numbers.jerk, {}),
        MetricValues("largest_speed", numbers.speed, {"too_fast": broken["too_fast"]}),
    )


_METRICS = (
    headline("plausible", "Plausible", "rate", 8, higher_is_better=True, ranked=False),
    detail("floating", "Floating", "m", 21, higher_is_better=False),
    detail("penetration", "Penetration", "m", 22, higher_is_better=False),
    detail("slow_slides", "Slow slides", "ratio", 23, higher_is_better=False),
    # Of jerk and speed, less is no merit within the limits: a body that stands still has none.
    detail("largest_jerk", "Largest jerk", "m/s³", 24, higher_is_better=None),
    detail("largest_speed", "Largest speed", "m/s", 25, higher_is_better=None),
)
FAMILY = MetricFamily(_METRICS, _compute)
