"""Parts that sheets, films and pages share: colours, bodies as lines, rays, the goal, points of the surroundings.

The colours can be told apart with any kind of colour vision (Okabe and Ito's set, two more of Tol's).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import BONES, Joint, head_forward
from prbench.viewing.figures import draw_box
from prbench.viewing.replay.scene import RECORDED, Scene, ShownMotion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D


RECORDED_COLOUR = "#303030"
METHOD_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#999933", "#882255")
"""Colours of the runs in the order in which they are named; more could not be told apart."""
GAZE_COLOUR = "#e69f00"
GOAL_COLOUR = "#56b4e9"
BOX_COLOUR = "#1b6f9c"
MARK_COLOUR = "#555555"
SURROUNDINGS_COLOUR = "#b8b8b8"
IS_THICK = np.array([not Joint(child).name.startswith("LEFT") for _, child in BONES])
"""True for right limbs and the trunk, in the order of ``skeleton.BONES``; left limbs are drawn thin."""
SLICE = 0.6
"""Metres before and behind a body within which a side view shows the surroundings."""

_BONES = np.array(BONES)
_LINE_WIDTHS = np.where(IS_THICK, 2.1, 0.9)  # points


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def gaze_style(motion: ShownMotion) -> dict[str, Any]:
    """Return how the gaze of one of several motions is drawn in a panel that they share."""
    if motion.label == RECORDED:
        return {"color": GAZE_COLOUR}
    return {"color": motion.colour, "linestyle": ":"}


def bone_segments(points: Float[np.ndarray, "*poses 22 k"]) -> Float[np.ndarray, "*poses 21 2 k"]:
    """Return both ends of every bone, in the order of ``skeleton.BONES``."""
    return points[..., _BONES, :]


def draw_bodies(
    axes: Axes, points: Float[np.ndarray, "poses 22 2"], colour: str, *, alpha: float = 1.0
) -> tuple[LineCollection, Line2D]:
    """Draw poses that are already flat.

    Returns:
        The lines, one a bone, pose after pose, and the markers of the heads; a film moves both.
    """
    from matplotlib.collections import LineCollection

    lines = LineCollection(
        list(bone_segments(points).reshape(-1, 2, 2)),
        colors=colour,
        linewidths=np.tile(_LINE_WIDTHS, len(points)),
        capstyle="round",
        alpha=alpha,
        zorder=3,
    )
    axes.add_collection(lines)
    (heads,) = axes.plot(*points[:, Joint.HEAD].T, "o", color=colour, markersize=4.5, alpha=alpha, zorder=3)
    return lines, heads


def side_view(
    points: Float[np.ndarray, "*n 3"], axis: Float[np.ndarray, "3"], around: Float[np.ndarray, "*m 3"] | None = None
) -> Float[np.ndarray, "*n 2"]:
    """Project points onto a horizontal axis, counted from ``around``, and onto the vertical; metres."""
    across = points @ axis
    if around is not None:
        across = across - around @ axis
    return np.stack([across, points[..., 1]], axis=-1)


def top_view(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Return ground coordinates (x, z), metres; :func:`limit_top_view` lets x grow to the left, as seen from above."""
    return points[..., [0, 2]]


def head_rays(
    joints: Float[np.ndarray, "n 22 3"], head_tilt_deg: float, goal: Float[np.ndarray, "3"] | None, longest: float
) -> Float[np.ndarray, "n 2 3"]:
    """Return head-forward rays from the head joint (docs/specification/humanml3d.md#head-forward-vector).

    Args:
        joints: Canonical frame, metres.
        head_tilt_deg: See :func:`prbench.geometry.skeleton.head_forward`.
        goal: See :func:`rays`.
        longest: See :func:`rays`.
    """
    forward, _ = head_forward(joints, head_tilt_deg)
    return rays(joints[:, Joint.HEAD], forward, goal, longest)


def rays(
    origin: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "n 3"],
    goal: Float[np.ndarray, "3"] | None,
    longest: float,
) -> Float[np.ndarray, "n 2 3"]:
    """Return segments from ``origin`` along the unit ``direction``, metres.

    A segment is as long as the distance to the goal, so that a ray that meets the goal ends there; ``longest`` where
    the goal is farther away or unknown.
    """
    length = np.full(len(origin), longest)
    if goal is not None:
        length = np.minimum(np.linalg.norm(goal - origin, axis=1), longest)
    return np.stack([origin, origin + length[:, None] * direction], axis=1)


def extent(scene: Scene, flat: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and greatest coordinates of what must be seen: pelvis paths, last poses and the goal.

    Args:
        scene: The sequence.
        flat: Maps points (..., 3) to the picture's coordinates.
    """
    points = [flat(motion.joints[:, Joint.PELVIS]) for motion in scene.motions]
    points += [flat(motion.joints[-1]) for motion in scene.motions]
    if scene.goal is not None:
        points.append(flat(scene.goal.box_corners))
    everything = np.concatenate(points)
    return everything.min(axis=0), everything.max(axis=0)


def limit_top_view(axes: Axes, scene: Scene, *, least: float, margin: float) -> None:
    """Let a square panel show everything from above, x to the left, as one who looks down sees it.

    Args:
        axes: The panel.
        scene: The sequence.
        least: Smallest side of the square without its margins, metres.
        margin: Metres around it.
    """
    low, high = extent(scene, top_view)
    x, z = (low + high) / 2
    half = max(float((high - low).max()), least) / 2 + margin
    # x grows to the left, as for somebody who looks down on a body that faces away from them.
    axes.set(xlim=(x + half, x - half), ylim=(z - half, z + half))
    axes.set_aspect("equal", adjustable="box")


def draw_goal(
    axes: Axes,
    corners: Float[np.ndarray, "8 2"],
    location: Float[np.ndarray, "2"],
    *,
    linewidth: float,
    markersize: float,
    zorder: int,
) -> None:
    """Draw the flat edges of a goal's box and a square at its location."""
    draw_box(axes, corners, color=BOX_COLOUR, linewidth=linewidth, zorder=zorder)
    axes.plot(*location, "s", color=GOAL_COLOUR, markersize=markersize, zorder=zorder)


def mark_times(axes: Axes, scene: Scene) -> None:
    """Mark prime window, prime time and event on a panel whose x axis is time, seconds."""
    window = scene.thresholds.prime_window
    axes.axvspan(scene.prime_time - window, scene.prime_time + window, color="0.92", zorder=0, linewidth=0)
    axes.axvline(scene.prime_time, color=MARK_COLOUR, linewidth=1.0, linestyle="--", zorder=1)
    axes.axvline(scene.event_time, color=MARK_COLOUR, linewidth=1.4, zorder=1)


def draw_dots(axes: Axes, points: Float[np.ndarray, "k 2"]) -> None:
    """Draw flat points of the surroundings behind everything else."""
    axes.scatter(*points.T, s=0.7, color=SURROUNDINGS_COLOUR, linewidths=0, zorder=0)


def beside(
    points: Float[np.ndarray, "k 3"],
    body: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    *,
    reach: float,
) -> Float[np.ndarray, "m 3"]:
    """Return the points of a slice around a body that a side view shows.

    Args:
        points: Canonical frame, metres.
        body: The pelvis.
        axis: Horizontal unit vector that points to the right in the view.
        reach: Metres to both sides.
    """
    offset = points - body
    # The axis and the vertical span the picture; what is left is the distance from its plane.
    depth = offset @ np.cross([0.0, 1.0, 0.0], axis)
    return points[(np.abs(offset @ axis) < reach) & (np.abs(depth) < SLICE)]
