"""Headings of poses about +Y, vectorised over frames."""

from __future__ import annotations

import numpy as np

from prbench.skeleton import Joint


def headings(poses: np.ndarray) -> np.ndarray:
    """Heading of each pose, radians, 0 = +Z, as :func:`prbench.skeleton.facing_yaw` defines it. (…, 22, 3) to (…)."""
    across = (
        poses[..., Joint.RIGHT_HIP, :]
        - poses[..., Joint.LEFT_HIP, :]
        + poses[..., Joint.RIGHT_SHOULDER, :]
        - poses[..., Joint.LEFT_SHOULDER, :]
    )
    return np.asarray(np.arctan2(across[..., 2], -across[..., 0]))


def wrapped(angles: np.ndarray) -> np.ndarray:
    """Angles between -pi and pi."""
    return np.mod(np.asarray(angles) + np.pi, 2 * np.pi) - np.pi


def turned(points: np.ndarray, yaw: float) -> np.ndarray:
    """Points turned about +Y; +Z goes towards +X."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
