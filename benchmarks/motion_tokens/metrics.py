"""Errors of reconstructed motions, pooled over all frames (docs/specification/motion-tokens.md#metrics)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import Joint

Joints = Float[np.ndarray, "frames joints 3"]
Sums = Float[np.ndarray, "3 2"]
_MM = 1000.0


def error_sums(reconstructed: Joints, recorded: Joints) -> Sums:
    """Sum the errors of one sequence.

    Args:
        reconstructed: Joint positions, the pelvis first, metres.
        recorded: The recorded ones, 3 frames or more, same frame of reference and unit.

    Returns:
        A row each for MPJPE after subtraction of the pelvis (mm), MPJPE after a similarity transform of each frame (mm)
        and ACC, the second difference of the global error (mm per frame²): sum over frames, and number of frames.
    """
    reconstructed, recorded = reconstructed.astype(np.float64), recorded.astype(np.float64)
    relative = [joints - joints[:, [Joint.PELVIS]] for joints in (reconstructed, recorded)]
    differences = (
        relative[0] - relative[1],
        aligned(reconstructed, recorded) - recorded,
        np.diff(reconstructed - recorded, n=2, axis=0),
    )
    per_frame = [_MM * np.linalg.norm(each, axis=-1).mean(axis=-1) for each in differences]
    return np.array([(each.sum(), len(each)) for each in per_frame])


def aligned(moved: Joints, fixed: Joints) -> Joints:
    """Turn, scale and shift each frame's points so that the sum of squared distances is the smallest (Umeyama 1991)."""
    centres = [points.mean(axis=1, keepdims=True) for points in (moved, fixed)]
    moved, centred = moved - centres[0], fixed - centres[1]
    left, values, right = np.linalg.svd(moved.mT @ centred)
    sign = np.ones_like(values)
    sign[:, -1] = np.sign(np.linalg.det(left @ right))  # a mirrored body is no turned one
    spread = np.square(moved).sum(axis=(1, 2))
    scale = (values * sign).sum(axis=1) / np.where(spread > 0, spread, 1.0)
    return scale[:, None, None] * (moved @ ((left * sign[:, None]) @ right)) + centres[1]


def pooled(sequences: Iterable[Sums]) -> tuple[float, float, float]:
    """Mean errors over the frames of all sequences; a long sequence counts more than a short one."""
    totals = np.sum(list(sequences), axis=0)
    mpjpe, pa_mpjpe, acc = totals[:, 0] / totals[:, 1]
    return float(mpjpe), float(pa_mpjpe), float(acc)
