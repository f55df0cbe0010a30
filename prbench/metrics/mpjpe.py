"""MPJPE: how far the whole predicted motion lies from the recorded one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS
from prbench.metrics.batch import MotionBatch, ScoringPair, require_equal_lengths
from prbench.metrics.registry import MetricFamily, MetricValues, study_error
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


def _compute(pair: ScoringPair, _: MetricConstants) -> tuple[MetricValues]:
    shorter = np.minimum(pair.predicted.n_frames, pair.recorded.n_frames)
    if (pair.predicted.n_frames == pair.recorded.n_frames).all():
        return (MetricValues("mpjpe", mpjpe(pair.predicted, pair.recorded), {}),)
    return (MetricValues("mpjpe", mpjpe(pair.predicted.shortened(shorter), pair.recorded.shortened(shorter)), {}),)


FAMILY = MetricFamily((study_error("mpjpe", "MPJPE", "m", 6, carries_copy_remark=True),), _compute)
