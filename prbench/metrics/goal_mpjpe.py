"""Goal MPJPE: how far the pose at the end lies from the recorded one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.metrics.batch import MotionBatch, ScoringPair
from prbench.metrics.registry import MetricFamily, MetricValues, study_error
from prbench.protocol.manifests import MetricConstants


def goal_mpjpe(predicted: MotionBatch, recorded: MotionBatch) -> Float[np.ndarray, " n"]:
    """Mean per-joint position error at the last frame, metres (docs/specification/metrics.md#goal-mpjpe).

    Global positions, no alignment, pelvis included. Each motion's own last frame counts.

    Args:
        predicted: Canonical frame, metres.
        recorded: Same frame and unit.
    """
    # float64, because the mean of 22 float32 norms would depend on the order of the sum.
    predicted_goal = predicted.values[predicted.last].astype(np.float64)
    return np.linalg.norm(predicted_goal - recorded.values[recorded.last].astype(np.float64), axis=-1).mean(axis=-1)


def _compute(pair: ScoringPair, _: MetricConstants) -> tuple[MetricValues]:
    return (MetricValues("goal_mpjpe", goal_mpjpe(pair.predicted, pair.recorded), {}),)


FAMILY = MetricFamily((study_error("goal_mpjpe", "Goal MPJPE", "m", 4),), _compute, minimum_frames=1)
