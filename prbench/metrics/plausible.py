"""Plausible: whether a body could move so at all, and the numbers that decide it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from prbench.metrics.batch import MotionBatch, ScoringPair
from prbench.metrics.bone_length_change import bone_length_change
from prbench.metrics.foot_skating import Fps, slow_slides
from prbench.metrics.posture import floating, largest_trunk_tilt, lowest_pelvis, penetration
from prbench.metrics.registry import MetricFamily, MetricInfo, MetricValues
from prbench.metrics.smoothness import largest_jerk
from prbench.protocol.manifests import MetricConstants


@dataclass(frozen=True, eq=False)
class BodyNumbers:
    """What decides whether each motion is plausible (docs/specification/metrics.md#plausible)."""

    lowest_pelvis: Float[np.ndarray, " n"]
    """Metres above the floor."""
    trunk_tilt: Float[np.ndarray, " n"]
    """Largest, degrees from the vertical."""
    floating: Float[np.ndarray, " n"]
    """Greatest height of the lower foot, metres."""
    penetration: Float[np.ndarray, " n"]
    """Greatest depth below the floor, metres."""
    bone_change: Float[np.ndarray, " n"]
    """Largest relative change of a bone's length; infinite where frame 0 has a bone without length."""
    slow_slides: Float[np.ndarray, " n"]
    """Share of frame transitions."""
    jerk: Float[np.ndarray, " n"]
    """Largest, m/s³."""
    speed: Float[np.ndarray, " n"]
    """Largest of a joint, m/s."""


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


def body_numbers(motion: MotionBatch, fps: Fps, constants: MetricConstants) -> BodyNumbers:
    """Measure everything that decides whether motions are plausible.

    Args:
        motion: Canonical frame, metres, two frames or more.
        fps: Frames per second.
        constants: Of the protocol; heights and speeds that count as a slide.
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
        numbers: Of :func:`body_numbers`.
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
        constants: Of the protocol.
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


def _number(name: str, title: str, unit: str, position: int, *, higher_is_better: bool | None) -> MetricInfo:
    """Describe a number that decides."""
    return MetricInfo(
        name,
        title,
        unit,
        higher_is_better=higher_is_better,
        main=False,
        position=position,
        compares_with_recorded=False,
    )


FAMILY = MetricFamily(
    (
        MetricInfo(
            "plausible",
            "Plausible",
            "rate",
            higher_is_better=True,
            main=True,
            ranked=False,
            position=8,
            compares_with_recorded=False,
        ),
        _number("floating", "Floating", "m", 21, higher_is_better=False),
        _number("penetration", "Penetration", "m", 22, higher_is_better=False),
        _number("slow_slides", "Slow slides", "ratio", 23, higher_is_better=False),
        # Of jerk and speed, less is no merit within the limits: a body that stands still has none.
        _number("largest_jerk", "Largest jerk", "m/s³", 24, higher_is_better=None),
        _number("largest_speed", "Largest speed", "m/s", 25, higher_is_better=None),
    ),
    _compute,
)
