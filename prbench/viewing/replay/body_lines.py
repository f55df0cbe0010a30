"""Bodies as line segments in a flat picture: right limbs thick, left limbs thin, all in one motion's colour."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.skeleton import BONES, Joint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

THIN, THICK = 0.9, 2.1  # points
HEAD = 4.5  # points
BONE_WIDTHS: tuple[float, ...] = tuple(THIN if Joint(child).name.startswith("LEFT") else THICK for _, child in BONES)
"""Line width of each bone, in the order of :data:`prbench.skeleton.BONES`; the trunk is thick."""

_PARENTS, _CHILDREN = (np.array(ends) for ends in zip(*BONES, strict=True))


def bone_segments(points: Float[np.ndarray, "*poses 22 k"]) -> Float[np.ndarray, "*poses 21 2 k"]:
    """Ends of every bone."""
    return np.stack([points[..., _PARENTS, :], points[..., _CHILDREN, :]], axis=-2)


def draw_bodies(
    axes: Axes, points: Float[np.ndarray, "poses 22 2"], colour: str, *, alpha: float = 1.0
) -> tuple[LineCollection, Line2D]:
    """Draw poses that are already flat, and return their lines, one a bone, pose after pose, and their heads."""
    from matplotlib.collections import LineCollection

    lines = LineCollection(
        list(bone_segments(points).reshape(-1, 2, 2)),
        colors=colour,
        linewidths=list(BONE_WIDTHS) * len(points),
        capstyle="round",
        alpha=alpha,
        zorder=3,
    )
    axes.add_collection(lines)
    (heads,) = axes.plot(*points[:, Joint.HEAD].T, "o", color=colour, markersize=HEAD, alpha=alpha, zorder=3)
    return lines, heads


def side_view(
    points: Float[np.ndarray, "*n 3"], axis: Float[np.ndarray, "3"], around: Float[np.ndarray, "*m 3"] | None = None
) -> Float[np.ndarray, "*n 2"]:
    """Along a horizontal axis, counted from ``around``, and up; metres."""
    across = points @ axis
    if around is not None:
        across = across - around @ axis
    return np.stack([across, points[..., 1]], axis=-1)


def top_view(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Ground coordinates (x, z); seen from above x grows to the left, which the axes of the picture see to."""
    return points[..., [0, 2]]
