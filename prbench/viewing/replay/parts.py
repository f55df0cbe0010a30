"""Parts that sheets, films and pages share: colours, bodies as lines, rays, points of what stood around."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.skeleton import BONES, Joint, head_forward

RECORDED_COLOUR = "#303030"
METHOD_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#999933", "#882255")
"""In the order in which runs are named; there are no more than can be told apart."""
GAZE_COLOUR = "#e69f00"
GOAL_COLOUR = "#56b4e9"
BOX_COLOUR = "#1b6f9c"
MARK_COLOUR = "#555555"
SURROUNDINGS_COLOUR = "#b8b8b8"


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


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


if TYPE_CHECKING:
    from matplotlib.axes import Axes

SLICE = 0.6
"""Metres before and behind a body within which a side view shows what stands there."""
_SIZE = 0.7  # square points


def draw_dots(axes: Axes, points: Float[np.ndarray, "k 2"]) -> None:
    """Draw flat points behind what is drawn later or has been drawn."""
    axes.scatter(*points.T, s=_SIZE, color=SURROUNDINGS_COLOUR, linewidths=0, zorder=0)


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
