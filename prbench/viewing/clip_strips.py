"""Filmstrips of a corpus' clips with their texts, for checking synthetic corpora by eye."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import Joint, canonical_frame, invert_rigid, transform_points
from prbench.shown import figure_text
from prbench.synthetic.activities import narrated_recording
from prbench.viewing.figures import draw_figure, grid_shape, new_figure, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FPS = 20.0
_RECORDINGS = 16
_N_FIGURES = 10
_SPACING = 1.05  # metres between the figures of a strip
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
        _draw(axes, strip)
    write_png(figure, path)


def _draw(axes: Axes, strip: Strip) -> None:
    frames = np.linspace(0, len(strip.joints) - 1, _N_FIGURES).round().astype(int)
    for number, frame in enumerate(frames):
        draw_figure(axes, strip.joints[frame], strip.head_tilt_deg, _SIDEWAYS, number * _SPACING)
    axes.set_title(figure_text(strip.text), fontsize=8, loc="left")
    axes.set_aspect("equal")
    axes.set_ylim(-0.05, 2.25)
    moved = np.linalg.norm((strip.joints[-1] - strip.joints[0])[Joint.PELVIS, [0, 2]])
    axes.set_xlabel(f"{len(strip.joints)} frames, pelvis ends {moved:.2f} m away", fontsize=7)
    axes.tick_params(labelsize=6)
