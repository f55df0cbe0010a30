"""The three panels of a sheet: poses over time, the way seen from above, curves towards the goal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from prbench.shown import figure_text
from prbench.skeleton import Joint
from prbench.viewing.replay.measures import gaze_angle, gaze_distance, measure
from prbench.viewing.replay.parts import (
    BOX_COLOUR,
    GAZE_COLOUR,
    GOAL_COLOUR,
    MARK_COLOUR,
    beside,
    draw_bodies,
    draw_dots,
    head_rays,
    lengths_to,
    rays,
    side_view,
    top_view,
)
from prbench.viewing.replay.scene import BOX_EDGES, RECORDED, Goal, Scene, ShownMotion

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
    _finish_strip(axes, scene, motion, frames, places, with_times=with_times)


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
            axes.plot(*ray.T, color=GAZE_COLOUR, linewidth=1.3, zorder=2)


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
                axes.plot(*box[[one, other]].T, color=BOX_COLOUR, linewidth=0.8, zorder=1)
            axes.plot(x, y, "s", color=GOAL_COLOUR, markersize=3.5, zorder=1)
        else:
            tip = place + np.sign(x - place) * 0.46 * _SPACING
            arrow = {"arrowstyle": "-|>", "color": BOX_COLOUR, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", (tip, y), (tip - np.sign(x - place) * 0.14 * _SPACING, y), arrowprops=arrow)


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
    name = "\nprime" if frame == scene.prime_frame else "\nevent" if frame == scene.n_frames - 1 else ""
    return f"{frame / scene.fps:.2f} s{name}"


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
        axes.plot(*top_view(ray)[0].T, color=GAZE_COLOUR, linewidth=1.5)
    if scene.goal is not None:
        box = top_view(scene.goal.box_corners)
        for one, other in BOX_EDGES:
            axes.plot(*box[[one, other]].T, color=BOX_COLOUR, linewidth=1.0, zorder=5)
        axes.plot(*top_view(scene.goal.location), "s", color=GOAL_COLOUR, markersize=5, zorder=5)
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


if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HIGHEST = 3.0  # metres shown of a distance


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
    if scene.gaze is not None and scene.shows_recorded:
        style: dict[str, Any] = {"color": GAZE_COLOUR, "linewidth": 1.0, "zorder": 1.5}
        ray.plot(scene.times, gaze_distance(scene.gaze, goal), **style)
        angle.plot(scene.times, gaze_angle(scene.gaze, goal), **style)
    ray.axhline(scene.thresholds.prime_distance, color=MARK_COLOUR, linewidth=0.8, linestyle=":")
    wrist.axhline(scene.thresholds.reach_distance, color=MARK_COLOUR, linewidth=0.8, linestyle=":")
    titles = (
        f"head ray to goal (m); primed below {scene.thresholds.prime_distance * 100:.0f} cm",
        "angle of head to goal (degrees)",
        f"nearer wrist to goal (m); reached below {scene.thresholds.reach_distance * 100:.0f} cm",
    )
    limits = (min(highest[ray] * 1.08, _HIGHEST), min(highest[angle] * 1.08, 180.0), highest[wrist] * 1.08)
    for panel, title, limit in zip(panels, titles, limits, strict=True):
        panel.set_ylim(0.0, max(limit, 0.3))
        _finish_curve(panel, scene, title)


def mark_times(axes: Axes, scene: Scene) -> None:
    """Prime window, prime time and event."""
    window = scene.thresholds.prime_window
    axes.axvspan(scene.prime_time - window, scene.prime_time + window, color="0.92", zorder=0, linewidth=0)
    axes.axvline(scene.prime_time, color=MARK_COLOUR, linewidth=1.0, linestyle="--", zorder=1)
    axes.axvline(scene.event_time, color=MARK_COLOUR, linewidth=1.4, zorder=1)


def _finish_curve(axes: Axes, scene: Scene, title: str) -> None:
    mark_times(axes, scene)
    axes.set_xlim(0.0, scene.event_time * 1.01)
    axes.set_title(title, fontsize=8, loc="left", pad=3)
    axes.set_xlabel("time (s)", fontsize=8)
    axes.tick_params(labelsize=7.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
