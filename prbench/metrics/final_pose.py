"""Goal MPJPE and Location Error: how far the body at the end is from the recorded one, and whether it is elsewhere."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import Joint
from prbench.metrics.batch import MotionBatch, ScoringPair
from prbench.metrics.registry import MetricFamily, MetricValues, compared_detail, study_error
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


def location_error(
    predicted: MotionBatch, recorded: MotionBatch, constants: MetricConstants, *, horizontal: bool = False
) -> Float[np.ndarray, " n"]:
    """1 where the final pelvis is ``location_error_distance`` or more from the recorded one.

    Source: docs/specification/metrics.md#location-error.

    Args:
        predicted: Canonical frame, metres.
        recorded: Same frame and unit.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
        horizontal: Compare x and z only, as Guided Motion Diffusion does.
    """
    axes = [0, 2] if horizontal else [0, 1, 2]
    predicted_end = predicted.values[predicted.last, Joint.PELVIS].astype(np.float64)
    recorded_end = recorded.values[recorded.last, Joint.PELVIS].astype(np.float64)
    distance = np.linalg.norm((predicted_end - recorded_end)[:, axes], axis=-1)
    # An error begins at the threshold itself, so the tolerance is subtracted here and added in Reach Success.
    return (distance >= constants.location_error_distance - constants.threshold_tolerance).astype(np.float64)


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, MetricValues, MetricValues]:
    pose = MetricValues("goal_mpjpe", goal_mpjpe(pair.predicted, pair.recorded), {})
    full = location_error(pair.predicted, pair.recorded, constants)
    horizontal = location_error(pair.predicted, pair.recorded, constants, horizontal=True)
    return pose, MetricValues("location_error", full, {}), MetricValues("location_error_horizontal", horizontal, {})


_METRICS = (
    study_error("goal_mpjpe", "Goal MPJPE", "m", 4),
    study_error("location_error", "Location Error", "rate", 5, title_in_study="Loc Err"),
    compared_detail("location_error_horizontal", "Location Error (horizontal)", "rate", 16, higher_is_better=False),
)
FAMILY = MetricFamily(_METRICS, _compute, minimum_frames=1)
