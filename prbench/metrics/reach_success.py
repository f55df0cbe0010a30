"""Reach Success: whether a wrist gets to the goal."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import WRISTS
from prbench.metrics.batch import MotionBatch, ScoringPair, final_reaching_wrist
from prbench.metrics.registry import MetricFamily, MetricValues, compared_detail, detail, headline
from prbench.protocol.manifests import MetricConstants


def reach_success(
    predicted: MotionBatch, goal_location: Float[np.ndarray, "n 3"], constants: MetricConstants, *, final: bool = False
) -> Float[np.ndarray, " n"]:
    """1 where either wrist comes within ``reach_distance`` of the goal (docs/specification/metrics.md#reach-success).

    Args:
        predicted: Canonical frame, metres.
        goal_location: Same frame and unit.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
        final: Only the last frame counts, instead of any.
    """
    squared = _squared_wrist_distance(predicted, goal_location)
    nearest = squared[predicted.last] if final else np.minimum.reduceat(squared, predicted.first)
    return _within_reach(nearest, constants)


def reach_wrist(
    predicted: MotionBatch,
    recorded: MotionBatch,
    goal_location: Float[np.ndarray, "n 3"],
    hand: Int[np.ndarray, " n"],
    constants: MetricConstants,
) -> Float[np.ndarray, " n"]:
    """1 where either wrist comes, in any frame, within ``reach_distance`` of where the recorded wrist ended.

    The recorded wrist is that of the reaching hand or, where the hand is unknown (-1), the one nearer to the goal.

    Args:
        predicted: Canonical frame, metres.
        recorded: Same frame and unit.
        goal_location: Same frame and unit; decides between the wrists where the hand is unknown.
        hand: 0 left, 1 right, -1 unknown.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
    """
    return reach_success(predicted, final_reaching_wrist(recorded, goal_location, hand), constants)


def _squared_wrist_distance(motion: MotionBatch, goal: np.ndarray) -> np.ndarray:
    """Squared distance of the nearer wrist in each frame."""
    goal_of_row = np.repeat(goal.T, motion.n_frames, axis=1)
    # Squared distances: the root is taken of one value a sequence instead of two a frame.
    nearer = np.full(len(motion.values), np.inf)
    for wrist in WRISTS:
        offset = motion.columns[wrist] - goal_of_row
        offset *= offset
        np.minimum(nearer, offset[0] + offset[1] + offset[2], out=nearer)
    return nearer


def _within_reach(squared: np.ndarray, constants: MetricConstants) -> np.ndarray:
    return (np.sqrt(squared) <= constants.reach_distance + constants.threshold_tolerance).astype(np.float64)


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, ...]:
    predicted = pair.predicted
    targets = pair.targets
    squared = _squared_wrist_distance(predicted, targets.goal_location)
    at_any = _within_reach(np.minimum.reduceat(squared, predicted.first), constants)
    at_end = _within_reach(squared[predicted.last], constants)
    at_wrist = reach_wrist(predicted, pair.recorded, targets.goal_location, targets.hand, constants)
    return (
        MetricValues("reach_success", at_any, {}),
        MetricValues("reach_success_final", at_end, {}),
        MetricValues("reach_wrist", at_wrist, {}),
    )


_METRICS = (
    headline("reach_success", "Reach Success", "rate", 3, higher_is_better=True, in_study=True),
    detail("reach_success_final", "Reach Success (final)", "rate", 14, higher_is_better=True),
    compared_detail("reach_wrist", "Reach Success (recorded wrist)", "rate", 15, higher_is_better=True),
)
FAMILY = MetricFamily(_METRICS, _compute)
