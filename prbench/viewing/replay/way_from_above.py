"""The way of each body seen from above: pelvis paths, head directions, gaze and the goal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from prbench.skeleton import Joint
from prbench.viewing.replay import palette
from prbench.viewing.replay.body_lines import draw_bodies, top_view
from prbench.viewing.replay.dots import draw_dots
from prbench.viewing.replay.rays import head_rays, lengths_to, rays
from prbench.viewing.replay.scene import BOX_EDGES, RECORDED, Scene, ShownMotion

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TICK = 0.3  # metres: head direction of a pose along the way
_RAY = 6.0  # metres: longest head or gaze ray at prime time
_MARGIN, _LEAST = 0.45, 2.2  # metres


def draw_way(axes: Axes, scene: Scene, frames: Int[np.ndarray, " poses"]) -> None:
    """Draw all motions of a sequence into one map; metres, x to the left, as one who looks down sees it.

    Args:
        axes: Where.
        scene: The sequence.
        frames: Poses whose head direction is marked.
    """
    if scene.surroundings is not None:
        draw_dots(axes, top_view(scene.surroundings))
    for motion in scene.motions:
        _draw_motion(axes, scene, motion, frames)
    if scene.gaze is not None and scene.shows_recorded and scene.gaze.valid[scene.prime_frame]:
        origin, direction = (values[[scene.prime_frame]] for values in (scene.gaze.origin, scene.gaze.direction))
        ray = rays(origin, direction, lengths_to(origin, _location(scene), _RAY))
        axes.plot(*top_view(ray)[0].T, color=palette.GAZE, linewidth=1.5)
    if scene.goal is not None:
        box = top_view(scene.goal.box_corners)
        for one, other in BOX_EDGES:
            axes.plot(*box[[one, other]].T, color=palette.GOAL_EDGE, linewidth=1.0, zorder=5)
        axes.plot(*top_view(scene.goal.location), "s", color=palette.GOAL, markersize=5, zorder=5)
    _frame(axes, scene)


def _location(scene: Scene) -> np.ndarray | None:
    return None if scene.goal is None else scene.goal.location


def _draw_motion(axes: Axes, scene: Scene, motion: ShownMotion, frames: Int[np.ndarray, " poses"]) -> None:
    path = top_view(motion.joints[:, Joint.PELVIS])
    axes.plot(*path.T, color=motion.colour, linewidth=2.0 if motion.label == RECORDED else 1.6, alpha=0.9)
    for tick in top_view(head_rays(motion.joints[frames], scene.head_tilt_deg, _TICK)):
        axes.plot(*tick.T, color=motion.colour, linewidth=0.8)
    at_prime = motion.joints[[scene.prime_frame]]
    ray = head_rays(at_prime, scene.head_tilt_deg, lengths_to(at_prime[:, Joint.HEAD], _location(scene), _RAY))
    axes.plot(*top_view(ray)[0].T, color=motion.colour, linewidth=1.1, linestyle=(0, (4, 2)))
    draw_bodies(axes, top_view(motion.joints[[-1]]), motion.colour, alpha=0.45)
    for frame, mark, size in ((0, "o", 5), (scene.prime_frame, "D", 6), (-1, "*", 11)):
        axes.plot(*path[frame], mark, color=motion.colour, markersize=size, markeredgecolor="white", zorder=6)


def _frame(axes: Axes, scene: Scene) -> None:
    low, high = _extent(scene)
    middle, half = (low + high) / 2, max(float((high - low).max()) / 2 + _MARGIN, _LEAST / 2)
    axes.set_xlim(middle[0] + half, middle[0] - half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("x (m), seen from above", fontsize=8)
    axes.set_ylabel("z (m)", fontsize=8)
    axes.tick_params(labelsize=7.5)
    axes.grid(alpha=0.25, linewidth=0.6)


def _extent(scene: Scene) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Corners of what must be seen: pelvis paths, last poses and the goal."""
    points = [top_view(motion.joints[:, Joint.PELVIS]) for motion in scene.motions]
    points += [top_view(motion.joints[-1]) for motion in scene.motions]
    if scene.goal is not None:
        points.append(top_view(scene.goal.box_corners))
    everything = np.concatenate(points)
    return everything.min(axis=0), everything.max(axis=0)
