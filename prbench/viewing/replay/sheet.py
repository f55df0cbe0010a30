"""The three panels of a sheet: poses over time, the way seen from above, curves towards the goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench.shown import figure_text
from prbench.viewing.figures import new_figure, write_png
from prbench.viewing.replay import scene as replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SPACING = 1.3  # metres between figures
_LONGEST_RAY = 0.85  # metres
_TICK = 0.3  # metres: head direction of a pose along the way
_RAY = 6.0  # metres: longest head or gaze ray at prime time
_HIGHEST = 3.0  # metres shown of a distance


def draw_strip(
    axes: Axes, scene: replay.Scene, motion: replay.ShownMotion, frames: Int[np.ndarray, " poses"], *, with_times: bool
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
        moved = replay.side_view(points, axis, around=pelvis[:, None])
        moved[..., 0] += places[:, None]
        return moved

    replay.draw_bodies(axes, flat(joints), motion.colour)
    goal = scene.goal_location
    for ray in flat(replay.head_rays(motion.joints[frames], scene.head_tilt_deg, goal, _LONGEST_RAY)):
        axes.plot(*ray.T, color=motion.colour, linewidth=1.0, linestyle=(0, (4, 2)), zorder=2)
    if motion.gaze is not None:
        segments = flat(replay.rays(motion.gaze.origin[frames], motion.gaze.direction[frames], goal, _LONGEST_RAY))
        for ray in segments[motion.gaze.valid[frames]]:
            axes.plot(*ray.T, color=replay.GAZE_COLOUR, linewidth=1.3, zorder=2)
    if scene.goal is not None:
        # Draw the goal beside each body that is near enough, else an arrow that points to it.
        for start, place in zip(pelvis, places, strict=True):

            def beside(points: np.ndarray, start: np.ndarray = start, place: float = place) -> np.ndarray:
                return replay.side_view(points, axis, around=start) + np.array([place, 0.0])

            location = beside(scene.goal.location)
            side = np.sign(location[0] - place)
            # Little more than half of the spacing: farther goals would lie beside the next body.
            if abs(location[0] - place) < 0.64 * _SPACING:
                replay.draw_goal(axes, scene.goal, beside, linewidth=0.8, markersize=3.5, zorder=1)
            else:
                tip = place + side * 0.46 * _SPACING
                arrow = {"arrowstyle": "-|>", "color": replay.BOX_COLOUR, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
                axes.annotate("", (tip, location[1]), (tip - side * 0.14 * _SPACING, location[1]), arrowprops=arrow)
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(-0.75, places[-1] + 0.95), ylim=(-0.05, 2.15), yticks=[0, 1, 2])
    axes.set_ylabel("height (m)", fontsize=7.5)
    axes.set_title(figure_text(motion.label), fontsize=9.5, color=motion.colour, weight="bold", loc="left", pad=2)
    marks = {scene.n_frames - 1: "event", scene.prime_frame: "prime"}
    times = [f"{frame / scene.fps:.2f} s\n{marks.get(int(frame), '')}".rstrip() for frame in frames]
    axes.set_xticks(places, times if with_times else [""] * len(places))
    axes.tick_params(labelsize=7.5, length=2)
    axes.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)


def draw_way(axes: Axes, scene: replay.Scene, frames: Int[np.ndarray, " poses"]) -> None:
    """Draw the paths of all motions of a sequence seen from above; metres.

    Args:
        axes: Panel to draw into.
        scene: The sequence.
        frames: Poses whose head direction is marked.
    """
    for motion in scene.motions:
        path = replay.top_view(motion.joints[:, Joint.PELVIS])
        axes.plot(*path.T, color=motion.colour, linewidth=2.0 if motion.label == replay.RECORDED else 1.6, alpha=0.9)
        for tick in replay.top_view(replay.head_rays(motion.joints[frames], scene.head_tilt_deg, None, _TICK)):
            axes.plot(*tick.T, color=motion.colour, linewidth=0.8)
        ray = replay.head_rays(motion.joints[[scene.prime_frame]], scene.head_tilt_deg, scene.goal_location, _RAY)
        axes.plot(*replay.top_view(ray)[0].T, color=motion.colour, linewidth=1.1, linestyle=(0, (4, 2)))
        if motion.gaze is not None and motion.gaze.valid[scene.prime_frame]:
            at_prime = [scene.prime_frame]
            ray = replay.rays(motion.gaze.origin[at_prime], motion.gaze.direction[at_prime], scene.goal_location, _RAY)
            axes.plot(*replay.top_view(ray)[0].T, linewidth=1.5, **replay.gaze_style(motion))
        replay.draw_bodies(axes, replay.top_view(motion.joints[[-1]]), motion.colour, alpha=0.45)
        for frame, mark, size in ((0, "o", 5), (scene.prime_frame, "D", 6), (-1, "*", 11)):
            axes.plot(*path[frame], mark, color=motion.colour, markersize=size, markeredgecolor="white", zorder=6)
    if scene.goal is not None:
        replay.draw_goal(axes, scene.goal, replay.top_view, linewidth=1.0, markersize=5.0, zorder=5)
    low, high = replay.extent(scene, replay.top_view)
    x, z = (low + high) / 2
    # A square of at least 1.3 m, and a margin around it.
    half = max(float((high - low).max()), 1.3) / 2 + 0.45
    # x grows to the left, as for somebody who looks down on a body that faces away from them.
    axes.set(xlim=(x + half, x - half), ylim=(z - half, z + half))
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("x (m), seen from above", fontsize=8)
    axes.set_ylabel("z (m)", fontsize=8)
    axes.tick_params(labelsize=7.5)
    axes.grid(alpha=0.25, linewidth=0.6)


def draw_curves(panels: tuple[Axes, Axes, Axes], scene: replay.Scene, goal: replay.Goal) -> None:
    """Distance and angle between head ray and goal, and the nearer wrist's distance, over time.

    Args:
        panels: Three axes.
        scene: The sequence.
        goal: Its goal.
    """
    ray, angle, wrist = panels
    highest = dict.fromkeys(panels, 0.0)
    for motion in scene.motions:
        values = replay.measure(motion, goal, scene.head_tilt_deg)
        for panel, curve in zip(panels, (values.head_distance, values.head_angle, values.wrist_distance), strict=True):
            panel.plot(scene.times, curve, color=motion.colour, linewidth=1.5)
            highest[panel] = max(highest[panel], float(curve.max()))
        if motion.gaze is not None:
            style = {"linewidth": 1.0, "zorder": 1.5, **replay.gaze_style(motion)}
            ray.plot(scene.times, replay.gaze_distance(motion.gaze, goal), **style)
            angle.plot(scene.times, replay.gaze_angle(motion.gaze, goal), **style)
    ray.axhline(scene.thresholds.prime_distance, color=replay.MARK_COLOUR, linewidth=0.8, linestyle=":")
    wrist.axhline(scene.thresholds.reach_distance, color=replay.MARK_COLOUR, linewidth=0.8, linestyle=":")
    titles = (
        f"head ray to goal (m); primed below {scene.thresholds.prime_distance * 100:.0f} cm",
        "angle of head to goal (degrees)",
        f"nearer wrist to goal (m); reached below {scene.thresholds.reach_distance * 100:.0f} cm",
    )
    # One method with large errors must not flatten the curves of the others.
    limits = (min(highest[ray] * 1.08, _HIGHEST), min(highest[angle] * 1.08, 180.0), highest[wrist] * 1.08)
    for panel, title, limit in zip(panels, titles, limits, strict=True):
        panel.set_ylim(0.0, max(limit, 0.3))
        # Mark prime window, prime time and event.
        window = scene.thresholds.prime_window
        panel.axvspan(scene.prime_time - window, scene.prime_time + window, color="0.92", zorder=0, linewidth=0)
        panel.axvline(scene.prime_time, color=replay.MARK_COLOUR, linewidth=1.0, linestyle="--", zorder=1)
        panel.axvline(scene.event_time, color=replay.MARK_COLOUR, linewidth=1.4, zorder=1)
        panel.set_xlim(0.0, scene.event_time * 1.01)
        panel.set_title(title, fontsize=8, loc="left", pad=3)
        panel.set_xlabel("time (s)", fontsize=8)
        panel.tick_params(labelsize=7.5)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)


_LEFT = 0.75
_STRIP_WIDTH = 9.55
_STRIP_HEIGHT = 1.85
_STRIP_STEP = 2.12
_RIGHT = 11.05
_WAY_SIDE = 3.6
_TITLE = 0.6
_CURVES_GAP = 0.75
_CURVES_HEIGHT = 1.75
_CURVES_WIDTH = 2.75
_CURVES_STEP = 3.4
_ROW = 0.24  # of the table of scores
_KEY = 1.15
_COLUMNS = (0.0, 0.47, 0.59, 0.71, 0.83, 0.925, 1.02)  # of the table's width: right edges, but for the first
_LABEL = 26  # characters of a label that fit
# Inches.
WIDTH = 15.0
# In one PNG: more would make a picture that few programs open.
MOST_SCENES = 40
_POSES = 9
_FOOT = 0.3  # inches, for the notice


def block_height(n_motions: int) -> float:
    """Return the height, inches, of a block with this number of motions."""
    left = _TITLE + n_motions * _STRIP_STEP + _CURVES_GAP + _CURVES_HEIGHT + 0.65
    right = _TITLE + _WAY_SIDE + 0.75 + (n_motions + 1.5) * _ROW + 0.15 + _KEY + 0.3
    return max(left, right)


@dataclass(frozen=True)
class Block:
    """The part of a sheet that belongs to one sequence.

    Attributes:
        top: Inches from the lower edge of the sheet.
    """

    figure: Figure
    top: float

    def text(self, left: float, down: float, text: str, **style: Any) -> None:
        """Write a line whose lower edge is ``down`` inches under the top of the block."""
        width, height = self.figure.get_size_inches()
        self.figure.text(left / width, (self.top - down) / height, figure_text(text), **style)

    def panel(self, left: float, down: float, width: float, height: float) -> Axes:
        """Add a panel whose upper left corner is so many inches from the left, and down from the top of the block."""
        figure_width, figure_height = self.figure.get_size_inches()
        bottom = self.top - down - height
        # Layout is reckoned in inches from the top; matplotlib takes shares of the figure from the bottom.
        place = (left / figure_width, bottom / figure_height, width / figure_width, height / figure_height)
        return self.figure.add_axes(place)


def draw_sheet(
    scenes: Sequence[replay.Scene], path: Path, *, dpi: int = 100, progress: replay.Progress | None = None
) -> None:
    """Draw sequences below one another and write the picture.

    Args:
        scenes: Scenes to draw, from top to bottom.
        path: PNG to write; replaced when it exists.
        dpi: Resolution.
        progress: Called after each sequence.

    Raises:
        ValueError: if there is nothing to draw.
        StorageError: if the file cannot be written.
    """
    if not scenes:
        raise ValueError("expected at least one sequence to draw, found none")
    heights = [block_height(len(scene.motions)) for scene in scenes]
    figure = new_figure(WIDTH, sum(heights) + _FOOT, dpi=dpi)
    top = sum(heights) + _FOOT
    for done, (scene, height) in enumerate(zip(scenes, heights, strict=True), start=1):
        draw_scene(Block(figure, top), scene)
        top -= height
        if progress is not None:
            progress(done, len(scenes), scene.sequence_id)
    notices = dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    if notices:
        height = figure.get_figheight()
        figure.text(
            0.35 / WIDTH, 0.12 / height, figure_text("   ".join(notices)), fontsize=8, color=replay.METHOD_COLOURS[1]
        )
    write_png(figure, path)


def draw_scene(block: Block, scene: replay.Scene) -> None:
    """Draw one sequence into its part of the sheet."""
    block.text(0.35, 0.25, scene.title, fontsize=12, weight="bold")
    block.text(0.35, 0.47, scene.sequence_id, fontsize=7.5, color="0.35", family="monospace")
    frames = chosen_frames(scene)
    n = len(scene.motions)
    for number, motion in enumerate(scene.motions):
        strip = block.panel(_LEFT, _TITLE + 0.25 + number * _STRIP_STEP, _STRIP_WIDTH, _STRIP_HEIGHT)
        draw_strip(strip, scene, motion, frames, with_times=number == n - 1)
    if scene.goal is not None:
        down = _TITLE + n * _STRIP_STEP + _CURVES_GAP
        places = [_LEFT + number * _CURVES_STEP for number in range(3)]
        one, two, three = (block.panel(left, down, _CURVES_WIDTH, _CURVES_HEIGHT) for left in places)
        draw_curves((one, two, three), scene, scene.goal)
    draw_way(block.panel(_RIGHT, _TITLE, _WAY_SIDE, _WAY_SIDE), scene, frames)
    # Write the table of scores, one row a motion, in the order of :data:`HEADER`.
    down = _TITLE + _WAY_SIDE + 0.75
    axes = block.panel(_RIGHT - 0.35, down, _WAY_SIDE + 0.5, (n + 1.5) * _ROW)
    axes.set_axis_off()
    rows = [replay.HEADER, *(replay.score_row(scene, motion) for motion in scene.motions)]
    colours = ["0.35", *(motion.colour for motion in scene.motions)]
    for number, (row, colour) in enumerate(zip(rows, colours, strict=True)):
        height = 1.0 - (number + 1.0) / (len(rows) + 0.5)
        # Columns beyond those that a sheet has room for are left out.
        for column, (place, text) in enumerate(zip(_COLUMNS, row, strict=True)):
            shown = text if len(text) <= _LABEL else f"{text[: _LABEL - 1]}…"
            side = "left" if column == 0 else "right"
            style: dict[str, Any] = {"ha": side, "va": "center", "fontsize": 7.5 if number else 7, "color": colour}
            axes.text(place, height, figure_text(shown), transform=axes.transAxes, **style)
    _draw_key(block.panel(_RIGHT - 0.35, down + (n + 1.5) * _ROW + 0.15, _WAY_SIDE + 0.5, _KEY), scene)


def chosen_frames(scene: replay.Scene) -> Int[np.ndarray, " poses"]:
    """Evenly spread frames, first and last among them; the one nearest to the prime time is moved onto it."""
    frames = np.unique(np.linspace(0, scene.n_frames - 1, _POSES).round().astype(int))
    if len(frames) > 2:
        inner = np.abs(frames[1:-1] - scene.prime_frame)
        # Moved and not added, so that all strips have equally many poses; first and last frame stay.
        frames[1 + int(inner.argmin())] = np.clip(scene.prime_frame, 1, scene.n_frames - 2)
    return np.unique(frames)


def _draw_key(axes: Axes, scene: replay.Scene) -> None:
    """Explain the lines and marks that this sequence's picture has."""
    from matplotlib.lines import Line2D

    with_gaze = [motion.label for motion in scene.motions if motion.gaze is not None]
    generated = bool(set(with_gaze) - {replay.RECORDED})
    entries: list[tuple[bool, str, dict[str, Any]]] = [
        (True, "right limbs and trunk (left: thin)", {"linewidth": 2.1}),
        (True, "head ray", {"linewidth": 1.1, "linestyle": (0, (4, 2))}),
        (bool(with_gaze), "gaze", {"linewidth": 1.5, "color": replay.GAZE_COLOUR}),
        (generated, "generated gaze (from above, curves)", {"linewidth": 1.5, "linestyle": ":"}),
        (scene.goal is not None, "goal and its box", {"marker": "s", "linestyle": "", "color": replay.GOAL_COLOUR}),
        (True, "first frame", {"marker": "o", "linestyle": "", "markersize": 5}),
        (True, "at prime time", {"marker": "D", "linestyle": "", "markersize": 5}),
        (True, "at the event", {"marker": "*", "linestyle": "", "markersize": 9}),
        (True, f"prime time ± {scene.thresholds.prime_window:g} s", {"linewidth": 7, "color": "0.88"}),
    ]
    handles = [
        Line2D([], [], label=label, **{"color": replay.MARK_COLOUR, **style})
        for drawn, label, style in entries
        if drawn
    ]
    axes.set_axis_off()
    axes.legend(handles=handles, fontsize=7.2, ncols=2, frameon=False, loc="upper left", borderaxespad=0.0)
