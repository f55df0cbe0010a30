"""Filmstrips, top views and curves of synthetic performances, for checking them by eye.

Source: docs/specification/synthetic-recordings.md#plausibility.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import TOES, WRISTS, Joint, canonical_frame, head_forward, invert_rigid, transform_points
from prbench.metrics.ray_track import ray_distance
from prbench.shown import figure_text
from prbench.synthetic.activities import narrated_recording
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.viewing.figures import draw_figure, flattened, grid_shape, horizontal_direction, new_figure, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

_STEP = 0.025  # seconds between the points of a curve
_N_FIGURES = 9
_SPACING = 1.15  # metres between the figures of a strip
_PREROLL = 2.0
_SHEET: tuple[tuple[str, int, int], ...] = (
    ("adt", 0, 1),
    ("adt", 1, 3),
    ("adt", 2, 2),
    ("hd-epic", 1, 1),
    ("hd-epic", 2, 2),
    ("mogaze", 0, 1),
    ("mogaze", 1, 2),
    ("hot3d", 2, 1),
    ("hot3d", 3, 2),
    ("gimo", 0, 1),
    ("gimo", 1, 2),
    ("gimo", 2, 1),
)
"""Preset, recording and number of the sequence: walking, standing, sitting, high and low goals."""


@dataclass(frozen=True)
class Curves:
    """Measurements from before the prime time to the event. Metres, seconds, degrees; times relative to the event."""

    times: Float[np.ndarray, " n"]
    gaze_distance: Float[np.ndarray, " n"]
    """Goal to the true gaze ray."""
    head_distance: Float[np.ndarray, " n"]
    """Goal to the head-forward ray of the joints."""
    wrist_distance: Float[np.ndarray, " n"]
    wrist_speed: Float[np.ndarray, " n"]
    pelvis_speed: Float[np.ndarray, " n"]
    pelvis_height: Float[np.ndarray, " n"]
    head_rate: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Scene:
    """One event of a performance, which one cell of the sheet shows."""

    performance: Performance
    event: TrueEvent

    @property
    def start(self) -> float:
        """Two seconds before the prime time, or before the reach if there is none; seconds of the recording."""
        first = self.event.prime_time if self.event.prime_time is not None else self.event.motor_start
        return max(float(self.performance.times[0]), first - _PREROLL)

    @property
    def end(self) -> float:
        """Time of the event, seconds of the recording."""
        return self.event.event_time

    @property
    def title(self) -> str:
        """Preset, number, action, object and kind of the event."""
        event = self.event
        return f"{self.performance.preset} #{self.performance.index}: {event.action} {event.object_name} ({event.tag})"


def render_contact_sheet(path: Path | str, *, seed: int = 7) -> None:
    """Synthesize and draw the twelve sequences of ``docs/gallery.png``.

    Args:
        path: PNG to write.
        seed: Seed of the performances.

    Raises:
        StorageError: if the file cannot be written.
    """
    scenes = []
    for preset, index, number in _SHEET:
        performance = perform(preset, seed=seed, index=index, n_events=6, provocations={})
        sequences = sequences_of([performance])
        # A changed generator may leave fewer sequences than the sheet names.
        scenes.append(sequences[min(number, len(sequences) - 1)])
    render_gallery(scenes, path)


def sequences_of(performances: Sequence[Performance]) -> list[Scene]:
    """Return all events of some performances that are meant to become sequences."""
    return [Scene(p, event) for p in performances for event in p.events if event.expected == "sequence"]


def render_gallery(scenes: Sequence[Scene], path: Path | str, *, columns: int = 3, dpi: int = 80) -> None:
    """Draw a contact sheet: for every scene two filmstrips, the top view and the curves.

    Args:
        scenes: Scenes to draw, row by row.
        path: PNG to write; replaced when it exists.
        columns: Scenes side by side.
        dpi: Resolution; a scene is 8 by 6.2 inches.

    Raises:
        ValueError: if there is nothing to show.
        StorageError: if the file cannot be written.
    """
    if not scenes:
        raise ValueError("expected at least one scene for the gallery, found none")
    rows, columns = grid_shape(len(scenes), columns)
    figure = new_figure(8.0 * columns, 6.2 * rows, dpi=dpi)
    cells = np.asarray(figure.subfigures(rows, columns, squeeze=False)).ravel()
    for cell, scene in zip(cells, scenes, strict=False):
        draw_scene(cell, scene)
    write_png(figure, path)


def draw_scene(cell: SubFigure, scene: Scene) -> None:
    """Fill one cell of the sheet."""
    axes = cell.add_gridspec(3, 3, height_ratios=[1.3, 1.3, 1.1], left=0.06, right=0.985, top=0.94, bottom=0.075)
    cell.suptitle(scene.title, fontsize=9, y=0.985)
    # The horizontal unit vector from the pelvis to the goal at the event.
    frame = _frame(scene, scene.end)
    towards = horizontal_direction(scene.event.goal - scene.performance.joints[frame, Joint.PELVIS])
    # The horizontal direction at a right angle to the way to the goal: the second strip looks along the reach.
    across = np.array([towards[2], 0.0, -towards[0]])
    _draw_strip(cell.add_subplot(axes[0, :]), scene, towards)
    _draw_strip(cell.add_subplot(axes[1, :]), scene, -across)
    _draw_top(cell.add_subplot(axes[2, 0]), scene)
    curves = curves_of(scene.performance, scene.event, scene.start, scene.end)
    _draw_distances(cell.add_subplot(axes[2, 1]), scene, curves)
    _draw_speeds(cell.add_subplot(axes[2, 2]), scene, curves)


def _frame(scene: Scene, time: float) -> int:
    times = scene.performance.times
    return min(int(np.searchsorted(times, time)), times.size - 1)


def _draw_strip(axes: Axes, scene: Scene, sideways: np.ndarray) -> None:
    """Draw figures from the first frame to the event, each with the goal at its place relative to that pelvis."""
    performance = scene.performance
    event = scene.event
    for number, time in enumerate(np.linspace(scene.start, scene.end, _N_FIGURES)):
        frame = _frame(scene, time)
        at = number * _SPACING
        joints = performance.joints[frame]
        goal = flattened(event.goal[None], joints[Joint.PELVIS], sideways, at)[0]
        if abs(goal[0] - at) < 0.75 * _SPACING:
            axes.plot(*goal, "s", color="tab:orange", markersize=4.5, markeredgecolor="k", markeredgewidth=0.4)
        draw_figure(
            axes,
            joints,
            performance.person.neck_tilt_deg,
            sideways,
            at,
            finger_bases=performance.finger_bases[frame],
        )
        axes.text(at, -0.13, f"{time - scene.end:+.1f}", fontsize=6, ha="center", va="top")
    axes.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
    axes.set_xlim(-0.8, (_N_FIGURES - 1) * _SPACING + 0.8)
    axes.set_ylim(-0.25, 2.0)
    axes.set_aspect("equal")
    axes.axis("off")


def _draw_top(axes: Axes, scene: Scene) -> None:
    """Draw the path of the pelvis, planted feet, fixated points, furniture and the goal from above."""
    performance = scene.performance
    event = scene.event
    for piece in performance.objects:
        if not piece.movable:
            axes.fill(*_outline(piece.position[0], piece.half_extents, piece.rotation[0]), color="0.9", zorder=0)
    span = slice(_frame(scene, scene.start), _frame(scene, scene.end) + 1)
    pelvis = performance.joints[span, Joint.PELVIS]
    axes.plot(pelvis[:, 0], pelvis[:, 2], color="0.2", linewidth=1.2)
    axes.plot(pelvis[0, 0], pelvis[0, 2], "o", color="0.2", markersize=4)
    for side, (toe, colour) in enumerate(zip(TOES, ("tab:blue", "tab:red"), strict=True)):
        planted = performance.joints[span, toe][performance.planted[span, side]]
        axes.plot(planted[:, 0], planted[:, 2], ".", color=colour, markersize=3)
    for fixation in performance.fixations:
        if fixation.end > scene.start and fixation.start < scene.end:
            colour = "tab:green" if fixation.kind == "goal" else "0.6"
            axes.plot(fixation.target[0], fixation.target[2], "+", color=colour, markersize=4, linewidth=0.5)
    axes.plot(event.goal[0], event.goal[2], "s", color="tab:orange", markersize=5, markeredgecolor="k")
    middle = pelvis[:, [0, 2]].mean(axis=0)
    reach = max(1.3, float(np.ptp(pelvis[:, [0, 2]], axis=0).max()) * 0.75)
    axes.set_xlim(middle[0] + reach, middle[0] - reach)  # x points left, so that the view is from above
    axes.set_ylim(middle[1] - reach, middle[1] + reach)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6)


def _outline(centre: np.ndarray, half: np.ndarray, quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x and z of the corners of a box that is turned about the vertical."""
    # Scalar first; furniture is turned about the vertical alone, so y and w hold the whole turn.
    yaw = 2.0 * np.arctan2(quaternion[2], quaternion[0])
    x = half[0] * np.array([1, 1, -1, -1])
    z = half[2] * np.array([1, -1, -1, 1])
    return centre[0] + np.cos(yaw) * x + np.sin(yaw) * z, centre[2] - np.sin(yaw) * x + np.cos(yaw) * z


def curves_of(performance: Performance, event: TrueEvent, start: float, end: float) -> Curves:
    """Measure one event of a performance between two times of the recording.

    Args:
        performance: Noise-free motion and gaze.
        event: The event; distances are to its goal, speeds of its hand.
        start: First time, seconds.
        end: Last time, seconds.
    """
    stride = max(1, round(_STEP * performance.rate))
    # Performances run at 120 Hz; a few of their frames are enough for a curve.
    first, last = np.searchsorted(performance.times, [start, end])
    frames = np.arange(int(first), min(int(last) + 1, performance.times.size), stride)
    joints = performance.joints[frames]
    times = performance.times[frames]
    forward, _ = head_forward(joints, performance.person.neck_tilt_deg)
    wrist = joints[:, WRISTS[event.hand == "right"]]
    # Rounding may bring the product of two unit vectors beyond 1, where the arc cosine is not defined.
    turning = np.arccos(np.clip((forward[1:] * forward[:-1]).sum(axis=1), -1.0, 1.0))
    return Curves(
        times=times - event.event_time,
        gaze_distance=ray_distance(performance.eye[frames], performance.gaze[frames], event.goal[None]),
        head_distance=ray_distance(joints[:, Joint.HEAD], forward, event.goal[None]),
        wrist_distance=np.linalg.norm(wrist - event.goal, axis=1),
        wrist_speed=_speed(wrist, times),
        pelvis_speed=_speed(joints[:, Joint.PELVIS], times),
        pelvis_height=joints[:, Joint.PELVIS, 1],
        head_rate=np.rad2deg(np.concatenate([[0.0], turning]) / (times[1] - times[0])),
    )


def _speed(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.gradient(points, times, axis=0), axis=1)


def _draw_distances(axes: Axes, scene: Scene, curves: Curves) -> None:
    axes.plot(curves.times, curves.gaze_distance, color="tab:green", linewidth=0.8, label="goal to gaze")
    axes.plot(curves.times, curves.head_distance, color="tab:purple", linewidth=1.0, label="goal to H")
    axes.plot(curves.times, curves.wrist_distance, color="tab:orange", linewidth=1.0, label="goal to wrist")
    axes.axhline(0.25, color="0.7", linewidth=0.5)
    axes.set_ylim(0.0, 2.0)
    _finish(axes, scene, "m")


def _draw_speeds(axes: Axes, scene: Scene, curves: Curves) -> None:
    axes.plot(curves.times, curves.wrist_speed, color="tab:orange", linewidth=1.0, label="wrist m/s")
    axes.plot(curves.times, curves.pelvis_speed, color="0.2", linewidth=1.0, label="pelvis m/s")
    axes.plot(curves.times, curves.pelvis_height, color="tab:brown", linewidth=1.0, label="pelvis height m")
    axes.plot(curves.times, curves.head_rate / 100.0, color="tab:purple", linewidth=0.7, label="H 100 deg/s")
    axes.set_ylim(0.0, 3.0)
    _finish(axes, scene, "")


def _finish(axes: Axes, scene: Scene, unit: str) -> None:
    """Mark prime time and reach start, and label the axes."""
    event = scene.event
    marks = ((event.prime_time, "--"), (event.reach_start, ":"))
    for time, style in marks:
        if time is not None:
            axes.axvline(time - event.event_time, color="0.5", linewidth=0.7, linestyle=style)
    axes.set_ylabel(unit, fontsize=6)
    axes.tick_params(labelsize=6)
    axes.legend(fontsize=5, loc="upper left", framealpha=0.6)


_FPS = 20.0
_RECORDINGS = 16
_N_FIGURES_OF_CLIP = 10
_SPACING_OF_CLIP = 1.05  # metres between the figures of a strip
_SIDEWAYS = np.array([0.5, 0.0, 0.8660254])  # seen from half the side: faces point to the right and towards the viewer


@dataclass(frozen=True)
class Strip:
    """One clip to draw."""

    text: str
    joints: Float[np.ndarray, "n 22 3"]
    """Canonical frame, metres."""
    head_tilt_deg: float


def strips_of_activities(seed: int) -> tuple[Strip, ...]:
    """Return one clip of every activity that synthetic people do, by name, from the first recordings of a seed."""
    strips: dict[str, Strip] = {}
    for index in range(_RECORDINGS):
        motion = narrated_recording(seed, index)
        for row in motion.narrations:
            # Only clips of a single activity: a narration of several would be shown under each of their names.
            if row.kind != "atomic_action" or len(row.activities) != 1 or row.activities[0] in strips:
                continue
            first = round(row.start * motion.rate)
            last = round(row.end * motion.rate)
            joints = motion.joints[first : last + 1 : round(motion.rate / _FPS)]
            # Each clip in its own canonical frame, so that all of them start at the same place and face the same way.
            canonical = transform_points(invert_rigid(canonical_frame(joints)), joints)
            strips[row.activities[0]] = Strip(f"[{row.activities[0]}] {row.texts[0]}", canonical, motion.neck_tilt_deg)
    return tuple(strips[name] for name in sorted(strips))


def render_strips(strips: Sequence[Strip], path: Path | str, *, columns: int = 2, dpi: int = 70) -> None:
    """Draw each clip as ten stick figures from first to last frame, its text above, the distance walked below.

    Args:
        strips: Clips, row by row.
        path: PNG to write; replaced when it exists.
        columns: Strips side by side.
        dpi: Resolution; a strip is 9 by 2.4 inches.

    Raises:
        ValueError: if there is nothing to show.
        StorageError: if the file cannot be written.
    """
    if not strips:
        raise ValueError("expected at least one clip to draw, found none")
    rows, columns = grid_shape(len(strips), columns)
    figure = new_figure(9.0 * columns, 2.4 * rows, dpi=dpi, layout="constrained")
    grid = np.asarray(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes in grid[len(strips) :]:
        axes.set_axis_off()
    for axes, strip in zip(grid, strips, strict=False):
        frames = np.linspace(0, len(strip.joints) - 1, _N_FIGURES_OF_CLIP).round().astype(int)
        for number, frame in enumerate(frames):
            draw_figure(axes, strip.joints[frame], strip.head_tilt_deg, _SIDEWAYS, number * _SPACING_OF_CLIP)
        axes.set_title(figure_text(strip.text), fontsize=8, loc="left")
        axes.set_aspect("equal")
        axes.set_ylim(-0.05, 2.25)
        moved = np.linalg.norm((strip.joints[-1] - strip.joints[0])[Joint.PELVIS, [0, 2]])
        axes.set_xlabel(f"{len(strip.joints)} frames, pelvis ends {moved:.2f} m away", fontsize=7)
        axes.tick_params(labelsize=6)
    write_png(figure, path)
