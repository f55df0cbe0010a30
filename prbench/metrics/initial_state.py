"""First frame error and first step: whether a motion goes on from the state that it was given."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.metrics.batch import MotionBatch, ScoringPair
from prbench.metrics.registry import MetricFamily, MetricValues, compared_detail, detail
from prbench.protocol.manifests import MetricConstants


def first_frame_error(predicted: MotionBatch, recorded: MotionBatch) -> Float[np.ndarray, " n"]:
    """Mean distance of the 22 joints in frame 0 from the given initial state, which is the recorded frame 0; metres.

    Source: docs/specification/metrics.md#first-frame-error-and-first-step.

    Args:
        predicted: Canonical frame, metres.
        recorded: Same frame and unit.
    """
    difference = predicted.values[predicted.first].astype(np.float64) - recorded.values[recorded.first]
    return np.linalg.norm(difference, axis=-1).mean(axis=-1)


def start_offset(pair: ScoringPair) -> Float[np.ndarray, " n"]:
    """Largest distance of a joint in frame 0 from the pose that the motion was given; 0 where it was given none.

    Source: docs/specification/metrics.md#first-frame-error-and-first-step.

    Args:
        pair: Canonical frame, metres.
    """
    predicted = pair.predicted
    return np.linalg.norm(predicted.values[predicted.first] - pair.first_poses, axis=-1).max(axis=-1)


def first_step(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Largest way of a joint from frame 0 to frame 1, metres.

    Source: docs/specification/metrics.md#first-frame-error-and-first-step.

    Args:
        motion: Metres, any frame.

    Raises:
        ValueError: if a sequence has fewer than two frames.
    """
    motion.require_frames(2)
    step = motion.values[motion.first + 1].astype(np.float64) - motion.values[motion.first]
    return np.linalg.norm(step, axis=-1).max(axis=-1)


def _compute(pair: ScoringPair, _: MetricConstants) -> tuple[MetricValues, MetricValues]:
    return (
        MetricValues("first_frame_error", first_frame_error(pair.predicted, pair.recorded), {}),
        MetricValues("first_step", first_step(pair.predicted), {}),
    )


_METRICS = (
    compared_detail("first_frame_error", "First frame error", "m", 19, higher_is_better=False),
    detail("first_step", "First step", "m", 20, higher_is_better=None),
)
FAMILY = MetricFamily(_METRICS, _compute)
