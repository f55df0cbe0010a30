"""Sequences as a PNG: poses over time, the way seen from above, curves towards the goal, and the scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from prbench.shown import figure_text
from prbench.viewing.figures import new_figure, write_png
from prbench.viewing.replay.measures import HEADER, score_row
from prbench.viewing.replay.panels import draw_curves, draw_strip, draw_way
from prbench.viewing.replay.parts import GAZE_COLOUR, GOAL_COLOUR, MARK_COLOUR, METHOD_COLOURS, SURROUNDINGS_COLOUR
from prbench.viewing.replay.scene import RECORDED, Progress, Scene

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
WIDTH = 15.0
"""Inches."""
MOST_SCENES = 40
"""In one PNG: more would make a picture that few programs open."""
_POSES = 9
_FOOT = 0.3  # inches, for the notice


def block_height(n_motions: int) -> float:
    """Return the height, inches, of a block with this number of motions."""
    left = _TITLE + n_motions * _STRIP_STEP + _CURVES_GAP + _CURVES_HEIGHT + 0.65
    right = _TITLE + _WAY_SIDE + 0.75 + (n_motions + 1.5) * _ROW + 0.15 + _KEY + 0.3
    return max(left, right)


@dataclass(frozen=True)
class Block:
    """The part of a sheet that belongs to one sequence."""

    figure: Figure
    top: float
    """Inches from the lower edge of the sheet."""

    def strip(self, number: int) -> Axes:
        """Add the panel for the poses of one motion."""
        return self._axes(_LEFT, _TITLE + 0.25 + number * _STRIP_STEP, _STRIP_WIDTH, _STRIP_HEIGHT)

    def curves(self, n_motions: int) -> tuple[Axes, Axes, Axes]:
        """Add the three panels for curves, side by side under the poses."""
        down = _TITLE + n_motions * _STRIP_STEP + _CURVES_GAP
        one, two, three = (
            self._axes(_LEFT + number * _CURVES_STEP, down, _CURVES_WIDTH, _CURVES_HEIGHT) for number in range(3)
        )
        return one, two, three

    def way(self) -> Axes:
        """Add the panel for the view from above."""
        return self._axes(_RIGHT, _TITLE, _WAY_SIDE, _WAY_SIDE)

    def scores(self, n_motions: int) -> Axes:
        """Add the panel for the table of scores."""
        return self._axes(_RIGHT - 0.35, _TITLE + _WAY_SIDE + 0.75, _WAY_SIDE + 0.5, (n_motions + 1.5) * _ROW)

    def key(self, n_motions: int) -> Axes:
        """Add the panel that explains lines and marks."""
        down = _TITLE + _WAY_SIDE + 0.75 + (n_motions + 1.5) * _ROW + 0.15
        return self._axes(_RIGHT - 0.35, down, _WAY_SIDE + 0.5, _KEY)

    def text(self, left: float, down: float, text: str, **style: Any) -> None:
        """Write a line whose lower edge is ``down`` inches under the top of the block."""
        width, height = self.figure.get_size_inches()
        self.figure.text(left / width, (self.top - down) / height, figure_text(text), **style)

    def _axes(self, left: float, down: float, width: float, height: float) -> Axes:
        figure_width, figure_height = self.figure.get_size_inches()
        bottom = self.top - down - height
        # Layout is reckoned in inches from the top; matplotlib takes shares of the figure from the bottom.
        place = (left / figure_width, bottom / figure_height, width / figure_width, height / figure_height)
        return self.figure.add_axes(place)


def draw_sheet(scenes: Sequence[Scene], path: Path, *, dpi: int = 100, progress: Progress | None = None) -> None:
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
    _write_notices(figure, scenes)
    write_png(figure, path)


def draw_scene(block: Block, scene: Scene) -> None:
    """Draw one sequence into its part of the sheet."""
    block.text(0.35, 0.25, scene.title, fontsize=12, weight="bold")
    block.text(0.35, 0.47, scene.sequence_id, fontsize=7.5, color="0.35", family="monospace")
    frames = chosen_frames(scene)
    for number, motion in enumerate(scene.motions):
        last = number == len(scene.motions) - 1
        draw_strip(block.strip(number), scene, motion, frames, with_times=last)
    if scene.goal is not None:
        draw_curves(block.curves(len(scene.motions)), scene, scene.goal)
    draw_way(block.way(), scene, frames)
    _draw_scores(block.scores(len(scene.motions)), scene)
    _draw_key(block.key(len(scene.motions)), scene)


def chosen_frames(scene: Scene) -> Int[np.ndarray, " poses"]:
    """Evenly spread frames, first and last among them; the one nearest to the prime time is moved onto it."""
    frames = np.unique(np.linspace(0, scene.n_frames - 1, _POSES).round().astype(int))
    if len(frames) > 2:
        inner = np.abs(frames[1:-1] - scene.prime_frame)
        # Moved and not added, so that all strips have equally many poses; first and last frame stay.
        frames[1 + int(inner.argmin())] = np.clip(scene.prime_frame, 1, scene.n_frames - 2)
    return np.unique(frames)


def _draw_scores(axes: Axes, scene: Scene) -> None:
    """Write the table of scores, one row a motion, in the order of :data:`HEADER`."""
    axes.set_axis_off()
    rows = [HEADER, *(score_row(scene, motion) for motion in scene.motions)]
    colours = ["0.35", *(motion.colour for motion in scene.motions)]
    for number, (row, colour) in enumerate(zip(rows, colours, strict=True)):
        height = 1.0 - (number + 1.0) / (len(rows) + 0.5)
        # Columns beyond those that a sheet has room for are left out.
        for column, (place, text) in enumerate(zip(_COLUMNS, row, strict=True)):
            shown = text if len(text) <= _LABEL else f"{text[: _LABEL - 1]}…"
            side = "left" if column == 0 else "right"
            style: dict[str, Any] = {"ha": side, "va": "center", "fontsize": 7.5 if number else 7, "color": colour}
            axes.text(place, height, figure_text(shown), transform=axes.transAxes, **style)


def _draw_key(axes: Axes, scene: Scene) -> None:
    """Explain the lines and marks that this sequence's picture has."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grey: dict[str, Any] = {"color": MARK_COLOUR}
    handles: list[Artist] = [
        Line2D([], [], linewidth=2.1, label="right limbs and trunk (left: thin)", **grey),
        Line2D([], [], linewidth=1.1, linestyle=(0, (4, 2)), label="head ray", **grey),
    ]
    with_gaze = [motion for motion in scene.motions if motion.gaze is not None]
    if with_gaze:
        handles.append(Line2D([], [], linewidth=1.5, color=GAZE_COLOUR, label="gaze"))
    if any(motion.label != RECORDED for motion in with_gaze):
        dotted: dict[str, Any] = {"linewidth": 1.5, "linestyle": ":", **grey}
        handles.append(Line2D([], [], label="generated gaze (from above, curves)", **dotted))
    if scene.goal is not None:
        handles.append(Line2D([], [], marker="s", linestyle="", color=GOAL_COLOUR, label="goal and its box"))
    handles += [
        Line2D([], [], marker="o", linestyle="", markersize=5, label="first frame", **grey),
        Line2D([], [], marker="D", linestyle="", markersize=5, label="at prime time", **grey),
        Line2D([], [], marker="*", linestyle="", markersize=9, label="at the event", **grey),
        Patch(facecolor="0.88", label=f"prime time ± {scene.thresholds.prime_window:g} s"),
    ]
    if scene.surroundings is not None:
        dots: dict[str, Any] = {"linestyle": "", "markersize": 2, "color": SURROUNDINGS_COLOUR}
        handles.append(Line2D([], [], marker="o", label="what stood around at the event", **dots))
    axes.set_axis_off()
    axes.legend(handles=handles, fontsize=7.2, ncols=2, frameon=False, loc="upper left", borderaxespad=0.0)


def _write_notices(figure: Figure, scenes: Sequence[Scene]) -> None:
    notices = dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    if notices:
        height = figure.get_figheight()
        figure.text(0.35 / WIDTH, 0.12 / height, figure_text("   ".join(notices)), fontsize=8, color=METHOD_COLOURS[1])
