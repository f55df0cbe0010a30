"""MPJPE, and first frame error and first step: how far the whole motion is from the recorded one, and its beginning."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS
from prbench.metrics.batch import MotionBatch, ScoringPair, require_equal_lengths
from prbench.metrics.registry import MetricFamily, MetricValues, compared_detail, detail, study_error
from prbench.protocol.manifests import MetricConstants


def mpjpe(predicted: MotionBatch, recorded: MotionBatch) -> Float[np.ndarray, " n"]:
    """Mean per-joint position error of each sequence, metres (docs/specification/metrics.md#mpjpe).

    Mean over all frames and joints of the distance between predicted and recorded joint. Global positions, no
    alignment, first frame and pelvis included. Average it over sequences, never over pooled frames.

    Args:
        predicted: Canonical frame, metres.
        recorded: Same frame, unit and lengths.

    Raises:
        ValueError: if a length differs.
    """
    require_equal_lengths(predicted, recorded)
    error = predicted.columns - recorded.columns
    error *= error
    squared = error[:, 0]
    squared += error[:, 1]
    squared += error[:, 2]
    distance = np.sqrt(squared)
    # Joint by joint, because ``distance.sum(axis=0)`` rounds differently for a single frame.
    per_frame = distance[0].copy()
    for row in distance[1:]:
        per_frame += row
    return np.add.reduceat(per_frame, predicted.first) / (N_JOINTS * predicted.n_frames)


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


def _compute(pair: ScoringPair, _: MetricConstants) -> tuple[MetricValues, ...]:
    predicted, recorded = pair.predicted, pair.recorded
    if (predicted.n_frames != recorded.n_frames).any():
        shorter = np.minimum(predicted.n_frames, recorded.n_frames)
        predicted, recorded = predicted.shortened(shorter), recorded.shortened(shorter)
    return (
        MetricValues("mpjpe", mpjpe(predicted, recorded), {}),
        MetricValues("first_frame_error", first_frame_error(pair.predicted, pair.recorded), {}),
        MetricValues("first_step", first_step(pair.predicted), {}),
    )


_METRICS = (
    study_error("mpjpe", "MPJPE", "m", 6, carries_copy_remark=True),
    compared_detail("first_frame_error", "First frame error", "m", 19, higher_is_better=False),
    detail("first_step", "First step", "m", 20, higher_is_better=None),
)
FAMILY = MetricFamily(_METRICS, _compute)
