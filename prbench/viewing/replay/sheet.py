"""A picture of sequences, as wide as a text column: bodies over time, the way seen from above, scores, distances."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench.shown import figure_text
from prbench.viewing.figures import draw_bodies, new_figure, styled, write_figure
from prbench.viewing.replay import scene as replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Inches.
COLUMN = 3.5
_EDGE = 0.06
_TITLE = 0.5
_STRIP = 1.22
_TIMES = 0.28
_WAY = 1.55
_ROW = 0.145
_BESIDE = 2  # motions whose scores have room beside the view from above
_CURVES = 1.0
KEY = 0.62
_GAP = 0.3
# Sequences in one picture: more would make one that few programs open.
MOST_SCENES = 40
_POSES = 5
_SPACING = 1.18  # metres between figures
_LONGEST_RAY = 0.75  # metres
_RAY = 6.0  # metres: longest head or gaze ray at prime time
_HIGHEST = 3.0  # metres shown of a distance
_DASHED = (0, (3, 1.5))
UP = np.array([0.0, 1.0, 0.0])


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

    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(-0.85, 5.8), ylim=(-0.06, 2.05), yticks=[])
    draw_bodies(axes, joints, motion.colour, flat, np.cross(axis, UP), head_tilt_deg=scene.head_tilt_deg)
    goal = scene.goal_location
    for ray in flat(replay.head_rays(joints, scene.head_tilt_deg, goal, _LONGEST_RAY)):
        axes.plot(*ray.T, color=motion.colour, linewidth=0.8, linestyle=_DASHED, zorder=4)
    if motion.gaze is not None:
        segments = flat(replay.rays(motion.gaze.origin[frames], motion.gaze.direction[frames], goal, _LONGEST_RAY))
        for ray in segments[motion.gaze.valid[frames]]:
            axes.plot(*ray.T, color=replay.GAZE_COLOUR, linewidth=1.0, zorder=4)
    if scene.goal is not None:
        # Draw the goal beside each body that is near enough, else an arrow that points to it.
        for start, place in zip(pelvis, places, strict=True):

            def beside(points: np.ndarray, start: np.ndarray = start, place: float = place) -> np.ndarray:
                return replay.side_view(points, axis, around=start) + np.array([place, 0.0])

            location = beside(scene.goal.location)
            side = np.sign(location[0] - place)
            # Little more than half of the spacing: farther goals would lie beside the next body.
            if abs(location[0] - place) < 0.64 * _SPACING:
                replay.draw_goal(axes, scene.goal, beside, linewidth=0.6, markersize=2.5, zorder=1)
            else:
                tip = place + side * 0.5 * _SPACING
                arrow = {"arrowstyle": "-|>", "color": replay.BOX_COLOUR, "linewidth": 0.8, "mutation_scale": 6}
                axes.annotate("", (tip, location[1]), (tip - side * 0.2 * _SPACING, location[1]), arrowprops=arrow)
    label = textwrap.shorten(motion.label, 44, placeholder=" …")
    axes.set_title(figure_text(label), color=motion.colour, weight="bold", pad=1)
    axes.plot([-0.8, -0.8], [0.0, 1.0], color=replay.MARK_COLOUR, linewidth=0.8)
    axes.text(-0.75, 0.5, "1 m", fontsize=6, color=replay.MARK_COLOUR, va="center")
    marks = {scene.n_frames - 1: "event", scene.prime_frame: "prime"}
    times = [f"{frame / scene.fps:.2f} s\n{marks.get(int(frame), '')}".rstrip() for frame in frames]
    axes.set_xticks(places, times if with_times else [""] * len(places))
    axes.tick_params(length=0)
    axes.axhline(0.0, color="0.75", linewidth=0.6, zorder=0)
    axes.spines[["left", "bottom"]].set_visible(False)


def draw_way(axes: Axes, scene: replay.Scene) -> None:
    """Draw the paths of all motions seen from above, and the body of the first one at three moments; metres."""
    low, high = replay.extent(scene, replay.top_view)
    x, z = (low + high) / 2
    # A square of at least 1.3 m, and a margin around it.
    half = max(float((high - low).max()), 1.3) / 2 + 0.35
    # x grows to the left, as for somebody who looks down on a body that faces away from them.
    axes.set(xlim=(x + half, x - half), ylim=(z - half, z + half))
    axes.set_aspect("equal", adjustable="box")
    prime = scene.prime_frame
    moments = ((0, "o", 3.0), (prime, "D", 3.0), (scene.n_frames - 1, "*", 6.0))
    tilt = scene.head_tilt_deg
    first = scene.motions[0]
    poses = first.joints[[frame for frame, _, _ in moments]]
    draw_bodies(axes, poses, replay.paler(first.colour), replay.top_view, UP, head_tilt_deg=tilt, zorder=2.0)
    for motion in scene.motions:
        path = replay.top_view(motion.joints[:, Joint.PELVIS])
        axes.plot(*path.T, color=motion.colour, linewidth=1.4, zorder=5)
        ray = replay.head_rays(motion.joints[[prime]], tilt, scene.goal_location, _RAY)
        axes.plot(*replay.top_view(ray)[0].T, color=motion.colour, linewidth=0.9, linestyle=_DASHED, zorder=4)
        if motion.gaze is not None and motion.gaze.valid[prime]:
            ray = replay.rays(motion.gaze.origin[[prime]], motion.gaze.direction[[prime]], scene.goal_location, _RAY)
            axes.plot(*replay.top_view(ray)[0].T, linewidth=1.1, zorder=4, **replay.gaze_style(motion))
        for frame, mark, size in moments:
            style: dict[str, Any] = {"color": motion.colour, "markeredgecolor": "white", "markeredgewidth": 0.5}
            axes.plot(*path[frame], mark, markersize=size, zorder=6, **style)
    if scene.goal is not None:
        replay.draw_goal(axes, scene.goal, replay.top_view, linewidth=0.8, markersize=3.5, zorder=5)
    axes.set_xlabel("from above (m)", labelpad=1)
    axes.locator_params(nbins=4)
    axes.grid(visible=True)
    axes.set_axisbelow(True)


def draw_curves(panels: tuple[Axes, Axes], scene: replay.Scene, goal: replay.Goal) -> None:
    """Draw the distances of the goal from the head ray and from the nearer wrist, over time.

    Args:
        panels: Two axes.
        scene: The sequence.
        goal: Its goal.
    """
    thresholds = scene.thresholds
    titles = ("head ray to goal (m)", "nearer wrist to goal (m)")
    highest = [0.0, 0.0]
    for motion in scene.motions:
        for number, curve in enumerate(replay.measure(motion, goal, scene.head_tilt_deg)):
            panels[number].plot(scene.times, curve, color=motion.colour)
            highest[number] = max(highest[number], float(curve.max()))
        if motion.gaze is not None:
            style = {"linewidth": 0.8, "zorder": 1.5, **replay.gaze_style(motion)}
            panels[0].plot(scene.times, replay.gaze_distance(motion.gaze, goal), **style)
    # One method with large errors must not flatten the curves of the others.
    limits = (min(highest[0] * 1.08, _HIGHEST), highest[1] * 1.08)
    window = thresholds.prime_window
    lines = (thresholds.prime_distance, thresholds.reach_distance)
    for panel, title, top, limit in zip(panels, titles, limits, lines, strict=True):
        panel.axhline(limit, color=replay.MARK_COLOUR, linewidth=0.7, linestyle=":")
        panel.axvspan(scene.prime_time - window, scene.prime_time + window, color="0.92", zorder=0, linewidth=0)
        panel.axvline(scene.prime_time, color=replay.MARK_COLOUR, linewidth=0.8, linestyle="--", zorder=1)
        panel.axvline(scene.event_time, color=replay.MARK_COLOUR, linewidth=1.1, zorder=1)
        panel.set(xlim=(0.0, scene.event_time * 1.01), ylim=(0.0, max(top, 0.3)))
        panel.set_title(title, fontsize=6.5, pad=2)
        panel.set_xlabel("time (s)", labelpad=1)


def block_height(n_motions: int) -> float:
    """Return the height, inches, of a block with this number of motions."""
    table = 0.0 if n_motions <= _BESIDE else len(replay.TITLES) * _ROW + 0.3 * _GAP
    return table + _TITLE + n_motions * _STRIP + _TIMES + _GAP / 2 + _WAY + 2 * _GAP + _CURVES + _GAP + _GAP / 2


@dataclass(frozen=True)
class Block:
    """The part of a picture that belongs to one sequence.

    Attributes:
        left: Inches from the left edge of the picture.
        top: Inches from its lower edge.
    """

    figure: Figure
    left: float
    top: float

    def text(self, down: float, text: str, **style: Any) -> None:
        """Write lines whose upper edge is ``down`` inches under the top of the block."""
        width, height = self.figure.get_size_inches()
        self.figure.text((self.left + _EDGE) / width, (self.top - down) / height, figure_text(text), va="top", **style)

    def panel(self, left: float, down: float, width: float, height: float) -> Axes:
        """Add a panel whose upper left corner is so many inches from the left, and down from the top of the block."""
        # Layout is reckoned in inches from the top; matplotlib takes shares of the figure from the bottom.
        place = np.array([self.left + left, self.top - down - height, width, height])
        return self.figure.add_axes(tuple(place / np.tile(self.figure.get_size_inches(), 2)))


@styled
def draw_sheet(
    scenes: Sequence[replay.Scene], path: Path, *, dpi: int | None = None, progress: replay.Progress | None = None
) -> str:
    """Draw sequences, write the picture and return its caption.

    One sequence is as wide as a text column; several stand in two or three columns, with one legend.

    Args:
        scenes: Scenes to draw.
        path: PNG, SVG or PDF to write; replaced when it exists.
        dpi: Resolution of a PNG; by default 200, and less for very large ones.
        progress: Called after each sequence.

    Raises:
        ValueError: if there is nothing to draw.
        StorageError: if the file cannot be written.
    """
    if not scenes:
        raise ValueError("expected at least one sequence to draw, found none")
    columns = min(len(scenes), 2 if len(scenes) <= 4 else 3)
    rows = [scenes[first : first + columns] for first in range(0, len(scenes), columns)]
    heights = [block_height(max(len(scene.motions) for scene in row)) for row in rows]
    notices = dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    foot = textwrap.wrap("   ".join(notices), 72 * columns)
    below = KEY + 0.12 * len(foot)
    total = sum(heights) + below
    # A side of a PNG has at most 2**15 pixels.
    figure = new_figure(COLUMN * columns, total, dpi=dpi or min(200, int(2**15 / total)))
    top = total
    done = 0
    for row, height in zip(rows, heights, strict=True):
        for number, scene in enumerate(row):
            draw_scene(Block(figure, number * COLUMN, top), scene)
            done += 1
            if progress is not None:
                progress(done, len(scenes), scene.sequence_id)
        top -= height
    draw_key(Block(figure, 0.0, below), scenes)
    figure.text(_EDGE / COLUMN / columns, 0.04 / total, figure_text("\n".join(foot)), fontsize=6, color="0.35")
    caption = caption_of(scenes)
    write_figure(figure, path, caption)
    return caption


def draw_scene(block: Block, scene: replay.Scene) -> None:
    """Draw one sequence into its part of the picture."""
    block.text(0.05, scene.title, fontsize=8.5, weight="bold")
    block.text(0.21, "\n".join(textwrap.wrap(scene.sequence_id, 66)), fontsize=6, color="0.35")
    frames = chosen_frames(scene)
    for number, motion in enumerate(scene.motions):
        strip = block.panel(_EDGE, _TITLE + 0.13 + number * _STRIP, COLUMN - 2 * _EDGE, _STRIP - 0.15)
        draw_strip(strip, scene, motion, frames, with_times=motion is scene.motions[-1])
    down = _TITLE + len(scene.motions) * _STRIP + _TIMES + _GAP / 2
    draw_way(block.panel(0.28, down, _WAY, _WAY), scene)
    # Write the scores, one row a metric and one column a motion, in its colour; beside the way where there is room.
    n = len(scene.motions)
    left, width = (2.0, 1.44) if n <= _BESIDE else (_EDGE, COLUMN - 2 * _EDGE)
    if n > _BESIDE:
        down += _WAY + _GAP * 1.3
    lines = len(replay.TITLES)
    axes = block.panel(left, down, width, lines * _ROW)
    axes.set_axis_off()
    for line, title in enumerate(replay.TITLES):
        height = 1.0 - (line + 0.5) / lines
        axes.text(0.0, height, title, va="center", fontsize=6.2, color="0.25")
        for number, motion in enumerate(scene.motions):
            right = 1.0 - (n - 1 - number) * 0.33 / width
            style: dict[str, Any] = {"ha": "right", "va": "center", "fontsize": 6.2, "color": motion.colour}
            axes.text(right, height, replay.score_row(scene, motion)[line], **style)
    down += lines * _ROW + _GAP if n > _BESIDE else _WAY + 2 * _GAP
    if scene.goal is not None:
        one, two = (block.panel(left, down, 1.4, _CURVES) for left in (0.28, 2.02))
        draw_curves((one, two), scene, scene.goal)


def chosen_frames(scene: replay.Scene) -> Int[np.ndarray, " poses"]:
    """Evenly spread frames, first and last among them; the one nearest to the prime time is moved onto it."""
    frames = np.unique(np.linspace(0, scene.n_frames - 1, _POSES).round().astype(int))
    if len(frames) > 2:
        inner = np.abs(frames[1:-1] - scene.prime_frame)
        # Moved and not added, so that all strips have equally many poses; first and last frame stay.
        frames[1 + int(inner.argmin())] = np.clip(scene.prime_frame, 1, scene.n_frames - 2)
    return np.unique(frames)


def draw_key(block: Block, scenes: Sequence[replay.Scene]) -> None:
    """Explain the lines and marks that the sequences of a picture have, once for all."""
    from matplotlib.lines import Line2D

    motions = [motion for scene in scenes for motion in scene.motions]
    with_gaze = [motion.label for motion in motions if motion.gaze is not None]
    generated = bool(set(with_gaze) - {replay.RECORDED})
    dark, light = replay.MARK_COLOUR, replay.paler(replay.MARK_COLOUR)
    mark = {"linestyle": "", "markersize": 3.5}
    entries: list[tuple[bool, str, dict[str, Any]]] = [
        (True, "right limbs, trunk", {"linewidth": 4, "color": dark}),
        (True, "left limbs", {"linewidth": 4, "color": light}),
        (True, "head ray", {"linewidth": 0.9, "linestyle": _DASHED}),
        (bool(with_gaze), "gaze", {"color": replay.GAZE_COLOUR}),
        (generated, "generated gaze, from above", {"linestyle": ":"}),
        (any(scene.goal is not None for scene in scenes), "goal", {"marker": "s", **mark, "color": replay.GOAL_COLOUR}),
        (True, "first frame", {"marker": "o", **mark}),
        (True, "prime", {"marker": "D", **mark}),
        (True, "event", {"marker": "*", "linestyle": "", "markersize": 6}),
        (True, f"prime ± {scenes[0].thresholds.prime_window:g} s", {"linewidth": 5, "color": "0.88"}),
    ]
    handles = [Line2D([], [], label=label, **{"color": dark, **style}) for drawn, label, style in entries if drawn]
    axes = block.panel(_EDGE, 0.02, COLUMN - 2 * _EDGE, KEY - 0.05)
    axes.set_axis_off()
    spacing = {"columnspacing": 1.0, "handlelength": 1.6, "handletextpad": 0.5, "labelspacing": 0.3}
    axes.legend(handles=handles, ncols=4, fontsize=6, loc="upper left", borderaxespad=0.0, **spacing)


def caption_of(scenes: Sequence[replay.Scene]) -> str:
    """Return the caption of a picture of sequences, as it would stand in a paper."""
    thresholds = scenes[0].thresholds
    labels = dict.fromkeys(motion.label for scene in scenes for motion in scene.motions)
    what = scenes[0].title if len(scenes) == 1 else f"{len(scenes)} sequences"
    sentences = [
        f"{what} of {', '.join(dict.fromkeys(scene.dataset for scene in scenes))}: {', '.join(labels)}",
        "Bodies from the side at the same moments, each around its own pelvis, the prime and the event among them",
        "Left limbs are lighter, dashed lines are head rays",
        "From above: the ways of the pelvis, and the first motion's body at the first frame, the prime and the event",
        f"Curves: distance of the goal from the head ray (primed within {100 * thresholds.prime_distance:.0f} cm,"
        f" {thresholds.prime_window:g} s around the prime: grey) and from the nearer wrist (reached within"
        f" {100 * thresholds.reach_distance:.0f} cm)",
    ]
    if scenes[0].dataset.startswith("synthetic-"):
        sentences.append("Synthetic people")
    return ". ".join([*sentences, *dict.fromkeys(scene.notice.rstrip(".") for scene in scenes if scene.notice)]) + "."
