"""Rays as line segments that can be drawn: from the head or the eye, no longer than a picture needs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.skeleton import Joint, head_forward


def head_rays(
    joints: Float[np.ndarray, "n 22 3"], head_tilt_deg: float, length: float | Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2 3"]:
    """Head-forward rays from the head joint (docs/specification/humanml3d.md#head-forward-vector).

    Args:
        joints: Canonical frame, metres.
        head_tilt_deg: Of the source skeleton.
        length: Of the segments, metres; one for all or one a frame.
    """
    forward, _ = head_forward(joints, head_tilt_deg)
    return rays(joints[:, Joint.HEAD], forward, length)


def rays(
    origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"], length: float | Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2 3"]:
    """Segments from ``origin`` along the unit ``direction``."""
    reach = np.broadcast_to(np.asarray(length, dtype=np.float64), (len(origin),))
    return np.stack([origin, origin + reach[:, None] * direction], axis=1)


def lengths_to(
    origin: Float[np.ndarray, "n 3"], goal: Float[np.ndarray, "3"] | None, longest: float
) -> Float[np.ndarray, " n"]:
    """As long as the way to the goal, so that a ray that meets it ends there; ``longest`` where it is farther away."""
    if goal is None:
        return np.full(len(origin), longest)
    return np.minimum(np.linalg.norm(goal - origin, axis=1), longest)
