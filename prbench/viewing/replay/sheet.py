"""Sequences as a PNG: poses over time, the way seen from above, curves towards the goal, and the scores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from prbench.locks import sole_file
from prbench.shown import figure_text
from prbench.viewing.replay.curves import draw_curves
from prbench.viewing.replay.layout import Block, block_height
from prbench.viewing.replay.legend import draw_key, draw_scores
from prbench.viewing.replay.parts import METHOD_COLOURS
from prbench.viewing.replay.pose_strip import draw_strip
from prbench.viewing.replay.scene import Scene
from prbench.viewing.replay.way_from_above import draw_way

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 15.0
"""Inches."""
MOST_SCENES = 40
"""In one PNG: more would make a picture that few programs open."""
_POSES = 9
_FOOT = 0.3  # inches, for the notice

Progress = Callable[[int, int, str], None]


def draw_sheet(scenes: Sequence[Scene], path: Path, *, dpi: int = 100, progress: Progress | None = None) -> None:
    """Draw sequences below one another and write the picture.

    Args:
        scenes: What to draw, from top to bottom.
        path: PNG to write; replaced when it exists.
        dpi: Resolution.
        progress: Called after each sequence.

    Raises:
        ValueError: if there is nothing to draw.
        StorageError: if the file cannot be written.
    """
    if not scenes:
        raise ValueError("expected at least one sequence to draw, found none")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    heights = [block_height(len(scene.motions)) for scene in scenes]
    figure = Figure(figsize=(WIDTH, sum(heights) + _FOOT), dpi=dpi)
    top = sum(heights) + _FOOT
    for done, (scene, height) in enumerate(zip(scenes, heights, strict=True), start=1):
        draw_scene(Block(figure, top=top, height=height), scene)
        top -= height
        if progress is not None:
            progress(done, len(scenes), scene.sequence_id)
    _write_notices(figure, scenes)
    with sole_file(path) as temporary, open(temporary, "wb") as file:
        FigureCanvasAgg(figure).print_png(file, metadata={"Software": None})


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
    draw_scores(block.scores(len(scene.motions)), scene)
    draw_key(block.key(len(scene.motions)), scene)


def chosen_frames(scene: Scene) -> Int[np.ndarray, " poses"]:
    """Evenly spread frames, first and last among them; the one nearest to the prime time is moved onto it."""
    frames = np.unique(np.linspace(0, scene.n_frames - 1, _POSES).round().astype(int))
    if len(frames) > 2:
        inner = np.abs(frames[1:-1] - scene.prime_frame)
        frames[1 + int(inner.argmin())] = np.clip(scene.prime_frame, 1, scene.n_frames - 2)
    return np.unique(frames)


def _write_notices(figure: Figure, scenes: Sequence[Scene]) -> None:
    notices = dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    if notices:
        height = figure.get_figheight()
        figure.text(0.35 / WIDTH, 0.12 / height, figure_text("   ".join(notices)), fontsize=8, color=METHOD_COLOURS[1])
