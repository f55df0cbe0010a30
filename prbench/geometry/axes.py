"""Turn worlds with Z up, as most datasets have, into that of recordings with Y up, and back."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Y_UP_FROM_Z_UP = np.array([(1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, -1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)])
"""A quarter turn about X: (x, y, z) becomes (x, z, -y)."""
Y_UP_FROM_Z_UP.setflags(write=False)


def y_up(points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """(x, y, z) with Z up as (x, z, -y) with Y up, without rounding; the type of the numbers stays."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def z_up(points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """The inverse of :func:`y_up`."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)
