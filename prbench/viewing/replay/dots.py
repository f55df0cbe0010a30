"""Points on what stood around a sequence, drawn behind everything else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.viewing.replay import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SLICE = 0.6
"""Metres before and behind a body within which a side view shows what stands there."""
_SIZE = 0.7  # square points


def draw_dots(axes: Axes, points: Float[np.ndarray, "k 2"]) -> None:
    """Draw flat points behind what is drawn later or has been drawn."""
    axes.scatter(*points.T, s=_SIZE, color=palette.SURROUNDINGS, linewidths=0, zorder=0)


def beside(
    points: Float[np.ndarray, "k 3"],
    body: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    *,
    reach: float,
) -> Float[np.ndarray, "m 3"]:
    """The points of a slice around a body that a side view shows.

    Args:
        points: Canonical frame, metres.
        body: The pelvis.
        axis: Horizontal unit vector that points to the right in the view.
        reach: Metres to both sides.
    """
    offset = points - body
    depth = offset @ np.cross([0.0, 1.0, 0.0], axis)
    return points[(np.abs(offset @ axis) < reach) & (np.abs(depth) < SLICE)]
