"""Poses of one motion from first to last frame, seen from the side, with what head and eyes point at."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from prbench.shown import figure_text
from prbench.skeleton import Joint
from prbench.viewing.replay import palette
from prbench.viewing.replay.body_lines import draw_bodies, side_view
from prbench.viewing.replay.dots import beside, draw_dots
from prbench.viewing.replay.rays import head_rays, lengths_to, rays
from prbench.viewing.replay.scene import BOX_EDGES, RECORDED, Scene, ShownMotion

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SPACING = 1.3  # metres between figures
_LONGEST_RAY = 0.85  # metres


def draw_strip(
    axes: Axes, scene: Scene, motion: ShownMotion, frames: Int[np.ndarray, " poses"], *, with_times: bool
) -> None:
    """Draw one motion; every body stands in the middle of its own place, whichever way it has gone.

    Args:
        axes: Where.
        scene: The sequence.
        motion: One of its motions.
        frames: Which poses.
        with_times: Whether to say under the figures when they are.
    """
    joints, axis = motion.joints[frames], scene.picture_axis
    pelvis, places = joints[:, Joint.PELVIS], np.arange(len(frames)) * _SPACING

    def flat(points: Float[np.ndarray, "poses k 3"]) -> Float[np.ndarray, "poses k 2"]:
        moved = side_view(points, axis, around=pelvis[:, None])
        moved[..., 0] += places[:, None]
        return moved

    if scene.surroundings is not None:
        for start, place in zip(pelvis, places, strict=True):
            near = beside(scene.surroundings, start, axis, reach=_SPACING / 2)
            draw_dots(axes, side_view(near, axis, around=start) + np.array([place, 0.0]))
    draw_bodies(axes, flat(joints), motion.colour)
    _draw_rays(axes, scene, motion, frames, flat)
    if scene.goal is not None:
        _draw_goals(axes, scene.goal.box_corners, scene.goal.location, pelvis, axis, places)
    _finish(axes, scene, motion, frames, places, with_times=with_times)


def _draw_rays(axes: Axes, scene: Scene, motion: ShownMotion, frames: np.ndarray, flat) -> None:
    location = None if scene.goal is None else scene.goal.location
    joints = motion.joints[frames]
    lengths = lengths_to(joints[:, Joint.HEAD], location, _LONGEST_RAY)
    for ray in flat(head_rays(joints, scene.head_tilt_deg, lengths)):
        axes.plot(*ray.T, color=motion.colour, linewidth=1.0, linestyle=(0, (4, 2)), zorder=2)
    if motion.label == RECORDED and scene.gaze is not None:
        origin, direction = scene.gaze.origin[frames], scene.gaze.direction[frames]
        segments = flat(rays(origin, direction, lengths_to(origin, location, _LONGEST_RAY)))
        for ray in segments[scene.gaze.valid[frames]]:
            axes.plot(*ray.T, color=palette.GAZE, linewidth=1.3, zorder=2)


def _draw_goals(
    axes: Axes,
    corners: Float[np.ndarray, "8 3"],
    location: Float[np.ndarray, "3"],
    pelvis: Float[np.ndarray, "poses 3"],
    axis: Float[np.ndarray, "3"],
    places: Float[np.ndarray, " poses"],
) -> None:
    """The goal's box beside each body that is near enough, else an arrow that points to where it lies."""
    for start, place in zip(pelvis, places, strict=True):
        shift = np.array([place, 0.0])
        x, y = side_view(location, axis, around=start) + shift
        if abs(x - place) < 0.64 * _SPACING:
            box = side_view(corners, axis, around=start) + shift
            for one, other in BOX_EDGES:
                axes.plot(*box[[one, other]].T, color=palette.GOAL_EDGE, linewidth=0.8, zorder=1)
            axes.plot(x, y, "s", color=palette.GOAL, markersize=3.5, zorder=1)
        else:
            tip = place + np.sign(x - place) * 0.46 * _SPACING
            arrow = {"arrowstyle": "-|>", "color": palette.GOAL_EDGE, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", (tip, y), (tip - np.sign(x - place) * 0.14 * _SPACING, y), arrowprops=arrow)


def _finish(
    axes: Axes,
    scene: Scene,
    motion: ShownMotion,
    frames: Int[np.ndarray, " poses"],
    places: Float[np.ndarray, " poses"],
    *,
    with_times: bool,
) -> None:
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(-0.75, places[-1] + 0.95), ylim=(-0.05, 2.15), yticks=[0, 1, 2])
    axes.set_ylabel("height (m)", fontsize=7.5)
    axes.set_title(figure_text(motion.label), fontsize=9.5, color=motion.colour, weight="bold", loc="left", pad=2)
    axes.set_xticks(places, [_when(scene, int(frame)) for frame in frames] if with_times else [""] * len(places))
    axes.tick_params(labelsize=7.5, length=2)
    axes.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)


def _when(scene: Scene, frame: int) -> str:
    name = "\nprime" if frame == scene.prime_frame else "\nevent" if frame == scene.n_frames - 1 else ""
    return f"{frame / scene.fps:.2f} s{name}"
