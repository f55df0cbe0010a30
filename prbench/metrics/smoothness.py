"""Jitter and largest jerk: how rough a motion is."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.metrics.batch import MotionBatch, sum_rows


def jitter(motion: MotionBatch, fps: float) -> Float[np.ndarray, " n"]:
    """Mean over frames and joints of the third difference's norm times fps³, m/s³.

    Source: docs/specification/metrics.md#jitter-and-largest-jerk.

    Raises:
        ValueError: if a sequence has fewer than four frames.
    """
    motion.require_frames(4)
    per_row = sum_rows(_third_difference(motion)) / len(motion.columns)
    return np.add.reduceat(per_row, motion.first) / (motion.n_frames - 3) * fps**3


def max_jerk(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Largest norm of the third difference over frames and joints, m/frame³.

    Source: docs/specification/metrics.md#jitter-and-largest-jerk.

    Raises:
        ValueError: if a sequence has fewer than four frames.
    """
    motion.require_frames(4)
    return np.maximum.reduceat(_third_difference(motion).max(axis=0), motion.first)


def largest_jerk(motion: MotionBatch, fps: float | Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Largest norm of the third difference over frames and joints times fps³, m/s³; 0 for fewer than four frames.

    Source: docs/specification/metrics.md#jitter-and-largest-jerk.
    """
    return np.maximum.reduceat(_third_difference(motion).max(axis=0), motion.first) * np.asarray(fps) ** 3


def _third_difference(motion: MotionBatch) -> Float[np.ndarray, "22 frames"]:
    """Norm of the third difference that starts at each row; 0 for the last three rows of a sequence."""
    norms = np.zeros((len(motion.columns), len(motion.values)))
    third = np.diff(motion.columns, n=3, axis=-1)
    norms[:, :-3] = np.sqrt(third[:, 0] ** 2 + third[:, 1] ** 2 + third[:, 2] ** 2)
    for k in range(3):
        norms[:, motion.last - k] = 0.0
    return norms
