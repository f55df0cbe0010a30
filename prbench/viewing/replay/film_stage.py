"""One picture after another of one sequence: what stands still is drawn once, what moves is drawn over it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from prbench.shown import figure_text
from prbench.skeleton import Joint
from prbench.viewing.replay import palette
from prbench.viewing.replay.body_lines import bone_segments, draw_bodies, side_view, top_view
from prbench.viewing.replay.captions import phase, verdict
from prbench.viewing.replay.curves import mark_times
from prbench.viewing.replay.dots import beside, draw_dots
from prbench.viewing.replay.film_layout import curve_panels, fit_limits, side_panels, top_panel
from prbench.viewing.replay.measures import gaze_distance, measure
from prbench.viewing.replay.rays import head_rays, lengths_to, rays
from prbench.viewing.replay.scene import BOX_EDGES, RECORDED, Goal, Scene, ShownMotion

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_DPI = 100
_LONGEST_RAY = 6.0  # metres
_FOOTPRINT = 0.5  # metres around what must be seen

Flatten = Callable[[np.ndarray], np.ndarray]
Update = Callable[[int], None]


class FilmStage:
    """The picture of one sequence at any frame.

    Args:
        scene: The sequence.
        size: Of the picture, pixels.
    """

    def __init__(self, scene: Scene, size: tuple[int, int]) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._scene = scene
        self._moving: list[tuple[Axes, Artist]] = []
        self._updates: list[Update] = []
        self._figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI)
        self._canvas = FigureCanvasAgg(self._figure)
        self._write_texts()
        self._build_side_views()
        self._build_top_view()
        if scene.goal is not None:
            self._build_curves(scene.goal)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)

    def picture(self, frame: int) -> bytes:
        """RGB bytes, row by row from the top, of one frame."""
        self._canvas.restore_region(self._background)
        for update in self._updates:
            update(frame)
        for axes, artist in self._moving:
            axes.draw_artist(artist)
        pixels = np.asarray(self._canvas.buffer_rgba())
        return np.ascontiguousarray(pixels[..., :3]).tobytes()

    def _write_texts(self) -> None:
        scene, write = self._scene, self._figure.text
        write(0.02, 0.962, figure_text(scene.title), fontsize=13, weight="bold")
        write(0.02, 0.935, figure_text(scene.sequence_id), fontsize=7.5, color="0.35", family="monospace")
        if scene.notice:
            write(0.02, 0.012, figure_text(scene.notice), fontsize=8, color=palette.METHODS[1])

    def _build_side_views(self) -> None:
        scene, axis = self._scene, self._scene.picture_axis
        low, high = self._extent(lambda points: points @ axis)
        for panel, motion in zip(side_panels(self._figure, len(scene.motions)), scene.motions, strict=True):
            fit_limits(panel, (low - _FOOTPRINT, high + _FOOTPRINT), (-0.05, self._height()))
            panel.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
            panel.tick_params(labelsize=7, length=2)
            panel.set_ylabel("m", fontsize=7.5)
            for side in ("top", "right"):
                panel.spines[side].set_visible(False)
            panel.set_title(
                figure_text(motion.label), fontsize=9.5, color=motion.colour, weight="bold", loc="left", pad=2
            )
            panel.set_title(verdict(scene, motion), fontsize=7.5, color="0.35", loc="right", pad=3)
            if scene.surroundings is not None:
                near = beside(scene.surroundings, motion.joints[-1, Joint.PELVIS], axis, reach=np.inf)
                draw_dots(panel, side_view(near, axis))
            self._add_goal(panel, lambda points: side_view(points, axis))
            self._add_body(panel, motion, lambda points: side_view(points, axis))

    def _build_top_view(self) -> None:
        scene, panel = self._scene, top_panel(self._figure)
        if scene.surroundings is not None:
            draw_dots(panel, top_view(scene.surroundings))
        self._add_goal(panel, top_view)
        for motion in scene.motions:
            path = top_view(motion.joints[:, Joint.PELVIS])
            panel.plot(*path.T, color=motion.colour, linewidth=0.9, alpha=0.5)
            self._add_body(panel, motion, top_view)
        (low_x, high_x), (low_z, high_z) = (self._extent(lambda points, k=k: points[..., k]) for k in (0, 2))
        half = max(high_x - low_x, high_z - low_z, 1.4) / 2 + _FOOTPRINT
        middle = (low_x + high_x) / 2, (low_z + high_z) / 2
        panel.set(xlim=(middle[0] + half, middle[0] - half), ylim=(middle[1] - half, middle[1] + half))
        panel.set_aspect("equal", adjustable="box")
        panel.set_title("seen from above (m)", fontsize=8, loc="left", pad=3)
        self._add_clock(panel)
        panel.tick_params(labelsize=7)
        panel.grid(alpha=0.25, linewidth=0.6)

    def _build_curves(self, goal: Goal) -> None:
        scene, (ray, wrist) = self._scene, curve_panels(self._figure)
        for motion in scene.motions:
            values = measure(motion, goal, scene.head_tilt_deg)
            ray.plot(scene.times, values.head_distance, color=motion.colour, linewidth=1.3)
            wrist.plot(scene.times, values.wrist_distance, color=motion.colour, linewidth=1.3)
        if scene.gaze is not None and scene.shows_recorded:
            ray.plot(scene.times, gaze_distance(scene.gaze, goal), color=palette.GAZE, linewidth=0.9, zorder=1.5)
        limits = scene.thresholds.prime_distance, scene.thresholds.reach_distance
        titles = "goal to head ray (m)", "goal to nearer wrist (m)"
        for panel, limit, title, what in zip((ray, wrist), limits, titles, ("primed", "reached"), strict=True):
            panel.axhline(limit, color=palette.MARK, linewidth=0.8, linestyle=":")
            panel.set(xlim=(0, scene.event_time * 1.01), ylim=(0, min(panel.get_ylim()[1], 2.5)))
            panel.set_title(f"{title}; {what} below {limit * 100:.0f} cm", fontsize=8, loc="left", pad=3)
            panel.tick_params(labelsize=7)
            mark_times(panel, scene)
            self._add_cursor(panel)
        wrist.set_xlabel(f"time (s); grey: prime time ± {scene.thresholds.prime_window:g} s", fontsize=7.5)

    def _add_goal(self, panel: Axes, flat: Flatten) -> None:
        if self._scene.goal is not None:
            box = flat(self._scene.goal.box_corners)
            for one, other in BOX_EDGES:
                panel.plot(*box[[one, other]].T, color=palette.GOAL_EDGE, linewidth=1.0, zorder=1)
            panel.plot(*flat(self._scene.goal.location), "s", color=palette.GOAL, markersize=4, zorder=1)

    def _add_body(self, panel: Axes, motion: ShownMotion, flat: Flatten) -> None:
        scene = self._scene
        location = None if scene.goal is None else scene.goal.location
        points = flat(motion.joints)
        lengths = lengths_to(motion.joints[:, Joint.HEAD], location, _LONGEST_RAY)
        self._add_ray(
            panel,
            flat(head_rays(motion.joints, scene.head_tilt_deg, lengths)),
            {"color": motion.colour, "linewidth": 1.2, "linestyle": (0, (4, 2))},
        )
        if motion.label == RECORDED and scene.gaze is not None:
            lengths = lengths_to(scene.gaze.origin, location, _LONGEST_RAY)
            segments = flat(rays(scene.gaze.origin, scene.gaze.direction, lengths))
            segments = np.where(scene.gaze.valid[:, None, None], segments, np.nan)
            self._add_ray(panel, segments, {"color": palette.GAZE, "linewidth": 1.6})
        lines, head = draw_bodies(panel, points[:1], motion.colour)
        bones = bone_segments(points)
        self._add(panel, lines, lambda frame: lines.set_segments(list(bones[frame])))
        self._add(panel, head, lambda frame: head.set_data(*points[frame, Joint.HEAD, :, None]))

    def _add_ray(self, panel: Axes, segments: Float[np.ndarray, "n 2 2"], style: dict[str, Any]) -> None:
        (line,) = panel.plot([], [], zorder=2, **style)
        self._add(panel, line, lambda frame: line.set_data(*segments[frame].T))

    def _add_cursor(self, panel: Axes) -> None:
        times = self._scene.times
        cursor = panel.axvline(0.0, color="black", linewidth=2.4)
        self._add(panel, cursor, lambda frame: cursor.set_xdata([times[frame], times[frame]]))

    def _add_clock(self, panel: Axes) -> None:
        scene = self._scene
        place = {"transform": self._figure.transFigure, "clip_on": False, "ha": "right"}
        clock = panel.text(0.98, 0.962, "", fontsize=13, weight="bold", **place)
        self._add(panel, clock, lambda frame: clock.set_text(f"{phase(scene, frame)}{frame / scene.fps:5.2f} s"))

    def _add(self, panel: Axes, artist: Artist, update: Update) -> None:
        artist.set_animated(True)
        self._moving.append((panel, artist))
        self._updates.append(update)

    def _height(self) -> float:
        highest = max(float(motion.joints[..., 1].max()) for motion in self._scene.motions)
        return max(2.0, highest + 0.1)

    def _extent(self, coordinate: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
        """Least and greatest value of a coordinate over all pelvis ways, last poses and the goal."""
        values = [coordinate(motion.joints[:, Joint.PELVIS]) for motion in self._scene.motions]
        values += [coordinate(motion.joints[-1]) for motion in self._scene.motions]
        if self._scene.goal is not None:
            values.append(coordinate(self._scene.goal.box_corners))
        everything = np.concatenate(values)
        return float(everything.min()), float(everything.max())
