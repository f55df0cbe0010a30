"""The three panels of a sheet: poses over time, the way seen from above, curves towards the goal."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench.shown import figure_text
from prbench.viewing.replay.measures import gaze_angle, gaze_distance, measure
from prbench.viewing.replay.parts import (
    BOX_COLOUR,
    GAZE_COLOUR,
    MARK_COLOUR,
    beside,
    draw_bodies,
    draw_dots,
    draw_goal,
    gaze_style,
    head_rays,
    limit_top_view,
    mark_times,
    rays,
    side_view,
    top_view,
)
from prbench.viewing.replay.scene import RECORDED, Goal, Scene, ShownMotion

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_SPACING = 1.3  # metres between figures
_LONGEST_RAY = 0.85  # metres
_TICK = 0.3  # metres: head direction of a pose along the way
_RAY = 6.0  # metres: longest head or gaze ray at prime time
_HIGHEST = 3.0  # metres shown of a distance


def draw_strip(
    axes: Axes, scene: Scene, motion: ShownMotion, frames: Int[np.ndarray, " poses"], *, with_times: bool
) -> None:
    """Draw poses of one motion from the side; every body stands in the middle of its own place, however far it walked.

    Args:
        axes: Panel to draw into.
        scene: The sequence.
        motion: One of its motions.
        frames: Frames of the poses.
        with_times: Write the time of each pose below it.
    """
    joints = motion.joints[frames]
    axis = scene.picture_axis
    pelvis = joints[:, Joint.PELVIS]
    places = np.arange(len(frames)) * _SPACING

    def flat(points: Float[np.ndarray, "poses k 3"]) -> Float[np.ndarray, "poses k 2"]:
        # Each pose is drawn around its own pelvis; how far the body walked is what the view from above shows.
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
        _draw_goals(axes, scene.goal, pelvis, axis, places)
    _finish_strip(axes, scene, motion, frames, places, with_times=with_times)


def _draw_rays(
    axes: Axes,
    scene: Scene,
    motion: ShownMotion,
    frames: Int[np.ndarray, " poses"],
    flat: Callable[[np.ndarray], np.ndarray],
) -> None:
    goal = scene.goal_location
    for ray in flat(head_rays(motion.joints[frames], scene.head_tilt_deg, goal, _LONGEST_RAY)):
        axes.plot(*ray.T, color=motion.colour, linewidth=1.0, linestyle=(0, (4, 2)), zorder=2)
    if motion.gaze is not None:
        segments = flat(rays(motion.gaze.origin[frames], motion.gaze.direction[frames], goal, _LONGEST_RAY))
        for ray in segments[motion.gaze.valid[frames]]:
            axes.plot(*ray.T, color=GAZE_COLOUR, linewidth=1.3, zorder=2)


def _draw_goals(
    axes: Axes,
    goal: Goal,
    pelvis: Float[np.ndarray, "poses 3"],
    axis: Float[np.ndarray, "3"],
    places: Float[np.ndarray, " poses"],
) -> None:
    """Draw the goal beside each body that is near enough, else an arrow that points to it."""
    for start, place in zip(pelvis, places, strict=True):
        shift = np.array([place, 0.0])
        location = side_view(goal.location, axis, around=start) + shift
        side = np.sign(location[0] - place)
        # Little more than half of the spacing: farther goals would lie beside the next body.
        if abs(location[0] - place) < 0.64 * _SPACING:
            corners = side_view(goal.box_corners, axis, around=start) + shift
            draw_goal(axes, corners, location, linewidth=0.8, markersize=3.5, zorder=1)
        else:
            tip = place + side * 0.46 * _SPACING
            arrow = {"arrowstyle": "-|>", "color": BOX_COLOUR, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", (tip, location[1]), (tip - side * 0.14 * _SPACING, location[1]), arrowprops=arrow)


def _finish_strip(
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
    time = f"{frame / scene.fps:.2f} s"
    if frame == scene.prime_frame:
        return f"{time}\nprime"
    return f"{time}\nevent" if frame == scene.n_frames - 1 else time


def draw_way(axes: Axes, scene: Scene, frames: Int[np.ndarray, " poses"]) -> None:
    """Draw the paths of all motions of a sequence seen from above; metres.

    Args:
        axes: Panel to draw into.
        scene: The sequence.
        frames: Poses whose head direction is marked.
    """
    if scene.surroundings is not None:
        draw_dots(axes, top_view(scene.surroundings))
    for motion in scene.motions:
        _draw_motion(axes, scene, motion, frames)
    if scene.goal is not None:
        corners = top_view(scene.goal.box_corners)
        draw_goal(axes, corners, top_view(scene.goal.location), linewidth=1.0, markersize=5.0, zorder=5)
    limit_top_view(axes, scene, least=1.3, margin=0.45)
    axes.set_xlabel("x (m), seen from above", fontsize=8)
    axes.set_ylabel("z (m)", fontsize=8)
    axes.tick_params(labelsize=7.5)
    axes.grid(alpha=0.25, linewidth=0.6)


def _draw_motion(axes: Axes, scene: Scene, motion: ShownMotion, frames: Int[np.ndarray, " poses"]) -> None:
    path = top_view(motion.joints[:, Joint.PELVIS])
    axes.plot(*path.T, color=motion.colour, linewidth=2.0 if motion.label == RECORDED else 1.6, alpha=0.9)
    for tick in top_view(head_rays(motion.joints[frames], scene.head_tilt_deg, None, _TICK)):
        axes.plot(*tick.T, color=motion.colour, linewidth=0.8)
    ray = head_rays(motion.joints[[scene.prime_frame]], scene.head_tilt_deg, scene.goal_location, _RAY)
    axes.plot(*top_view(ray)[0].T, color=motion.colour, linewidth=1.1, linestyle=(0, (4, 2)))
    if motion.gaze is not None and motion.gaze.valid[scene.prime_frame]:
        at_prime = [scene.prime_frame]
        ray = rays(motion.gaze.origin[at_prime], motion.gaze.direction[at_prime], scene.goal_location, _RAY)
        axes.plot(*top_view(ray)[0].T, linewidth=1.5, **gaze_style(motion))
    draw_bodies(axes, top_view(motion.joints[[-1]]), motion.colour, alpha=0.45)
    for frame, mark, size in ((0, "o", 5), (scene.prime_frame, "D", 6), (-1, "*", 11)):
        axes.plot(*path[frame], mark, color=motion.colour, markersize=size, markeredgecolor="white", zorder=6)


def draw_curves(panels: tuple[Axes, Axes, Axes], scene: Scene, goal: Goal) -> None:
    """Distance and angle between head ray and goal, and the nearer wrist's distance, over time.

    Args:
        panels: Three axes.
        scene: The sequence.
        goal: Its goal.
    """
    ray, angle, wrist = panels
    highest = dict.fromkeys(panels, 0.0)
    for motion in scene.motions:
        values = measure(motion, goal, scene.head_tilt_deg)
        for panel, curve in zip(panels, (values.head_distance, values.head_angle, values.wrist_distance), strict=True):
            panel.plot(scene.times, curve, color=motion.colour, linewidth=1.5)
            highest[panel] = max(highest[panel], float(curve.max()))
        if motion.gaze is not None:
            style = {"linewidth": 1.0, "zorder": 1.5, **gaze_style(motion)}
            ray.plot(scene.times, gaze_distance(motion.gaze, goal), **style)
            angle.plot(scene.times, gaze_angle(motion.gaze, goal), **style)
    ray.axhline(scene.thresholds.prime_distance, color=MARK_COLOUR, linewidth=0.8, linestyle=":")
    wrist.axhline(scene.thresholds.reach_distance, color=MARK_COLOUR, linewidth=0.8, linestyle=":")
    titles = (
        f"head ray to goal (m); primed below {scene.thresholds.prime_distance * 100:.0f} cm",
        "angle of head to goal (degrees)",
        f"nearer wrist to goal (m); reached below {scene.thresholds.reach_distance * 100:.0f} cm",
    )
    # One method with large errors must not flatten the curves of the others.
    limits = (min(highest[ray] * 1.08, _HIGHEST), min(highest[angle] * 1.08, 180.0), highest[wrist] * 1.08)
    for panel, title, limit in zip(panels, titles, limits, strict=True):
        panel.set_ylim(0.0, max(limit, 0.3))
        _finish_curve(panel, scene, title)


def _finish_curve(axes: Axes, scene: Scene, title: str) -> None:
    mark_times(axes, scene)
    axes.set_xlim(0.0, scene.event_time * 1.01)
    axes.set_title(title, fontsize=8, loc="left", pad=3)
    axes.set_xlabel("time (s)", fontsize=8)
    axes.tick_params(labelsize=7.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
