"""Errors of bodies from head and wrists, one value a track (docs/specification/three-points.md#metrics)."""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench.metrics.registry import compared_detail, detail, study_error
from prbench_benchmarks.three_points.protocol import load_three_points_protocol

_JOINTS = load_three_points_protocol().joints
_error = partial(study_error, in_study=False)
_part = partial(compared_detail, higher_is_better=False)
METRICS = (
    _error("mpjpe", "MPJPE", "cm", 1),
    _error("mpjpe_lower", "lower body", "cm", 2),
    _error("mpjpe_upper", "upper body", "cm", 3),
    _error("mpjpe_hands", "hand PE", "cm", 4),
    _error("mpjve", "MPJVE", "cm/s", 5),
    _part("mpjpe_pelvis", "pelvis", "cm", 6),
    detail("jitter", "jitter", "m/s³", 7, higher_is_better=None),
    detail("jitter_recorded", "recorded jitter", "m/s³", 8, higher_is_better=None),
)


def tracking_errors(
    predicted: Float[np.ndarray, "batch frames 22 3"],
    recorded: Float[np.ndarray, "batch frames 22 3"],
    n_frames: Int[np.ndarray, " batch"],
    fps: float,
) -> dict[str, Float[np.ndarray, " batch"]]:
    """Score bodies against the recorded ones: global positions, nothing aligned.

    Args:
        predicted: World, metres.
        recorded: The measured positions, same frame and unit.
        n_frames: Frames of each track, 4 or more; whatever stands beyond them leaves no trace.
        fps: Frame rate, in frames per second.

    Returns:
        One value a track for each of :data:`METRICS`, in its unit. Average them over tracks, never over frames.
    """
    within = np.arange(predicted.shape[1]) < n_frames[:, None]
    predicted = np.where(within[:, :, None, None], predicted, 0.0).astype(np.float64)
    recorded = np.where(within[:, :, None, None], recorded, 0.0).astype(np.float64)

    def mean(differences: np.ndarray, order: int = 0) -> np.ndarray:
        """Mean length over joints and frames; a difference of some order is none of the first frames."""
        length = np.linalg.norm(np.diff(differences, n=order, axis=1), axis=-1).mean(axis=-1) * fps**order
        return np.where(within[:, order:], length, 0.0).sum(axis=1) / (n_frames - order)

    apart = 100.0 * (predicted - recorded)
    parts = {f"mpjpe_{name}": mean(apart[:, :, [Joint[each] for each in joints]]) for name, joints in _JOINTS.items()}
    parts |= {"jitter": mean(predicted, 3), "jitter_recorded": mean(recorded, 3)}
    return {"mpjpe": mean(apart), "mpjve": mean(apart, 1), **parts}
