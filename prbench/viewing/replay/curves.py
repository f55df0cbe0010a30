"""Curves under the figures: head ray, gaze and wrist against the goal, with what counts as primed and reached."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from prbench.viewing.replay.measures import gaze_angle, gaze_distance, measure
from prbench.viewing.replay.parts import GAZE_COLOUR, MARK_COLOUR
from prbench.viewing.replay.scene import Goal, Scene

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
        _finish(panel, scene, title)


def mark_times(axes: Axes, scene: Scene) -> None:
    """Prime window, prime time and event."""
    window = scene.thresholds.prime_window
    axes.axvspan(scene.prime_time - window, scene.prime_time + window, color="0.92", zorder=0, linewidth=0)
    axes.axvline(scene.prime_time, color=MARK_COLOUR, linewidth=1.0, linestyle="--", zorder=1)
    axes.axvline(scene.event_time, color=MARK_COLOUR, linewidth=1.4, zorder=1)


def _finish(axes: Axes, scene: Scene, title: str) -> None:
    mark_times(axes, scene)
    axes.set_xlim(0.0, scene.event_time * 1.01)
    axes.set_title(title, fontsize=8, loc="left", pad=3)
    axes.set_xlabel("time (s)", fontsize=8)
    axes.tick_params(labelsize=7.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
