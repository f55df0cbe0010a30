"""Filmstrips of a corpus' clips with their texts, to be looked at. matplotlib is imported when something is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.locks import sole_file
from prbench.shown import figure_text
from prbench.skeleton import Joint, canonical_frame, invert_rigid, transform_points
from prbench.synthetic.activities import narrated_recording
from prbench.viewing.stick_figure import draw_figure

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
    """One clip of every activity that invented people do, by name; from the first recordings of a seed."""
    strips: dict[str, Strip] = {}
    for index in range(_RECORDINGS):
        motion = narrated_recording(seed, index)
        for row in motion.narrations:
            if row.kind != "atomic_action" or len(row.activities) != 1 or row.activities[0] in strips:
                continue
            first, last = (round(time * motion.rate) for time in (row.start, row.end))
            joints = motion.joints[first : last + 1 : round(motion.rate / _FPS)]
            canonical = transform_points(invert_rigid(canonical_frame(joints)), joints)
            strips[row.activities[0]] = Strip(f"[{row.activities[0]}] {row.texts[0]}", canonical, motion.neck_tilt_deg)
    return tuple(strips[name] for name in sorted(strips))


def render_strips(strips: Sequence[Strip], path: Path | str, *, columns: int = 2, dpi: int = 70) -> None:
    """Draw each clip as ten stick figures from first to last frame, its text above, the way on the floor below.

    Args:
        strips: What to show, row by row.
        path: PNG to write; replaced when it exists.
        columns: Strips side by side.
        dpi: Resolution; a strip is 9 by 2.4 inches.

    Raises:
        ValueError: if there is nothing to show.
        StorageError: if the file cannot be written.
    """
    if not strips:
        raise ValueError("expected at least one clip to draw, found none")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(columns, len(strips))
    rows = -(-len(strips) // columns)
    figure = Figure(figsize=(9.0 * columns, 2.4 * rows), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    grid = np.asarray(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes in grid[len(strips) :]:
        axes.set_axis_off()
    for axes, strip in zip(grid, strips, strict=False):
        _draw(axes, strip)
    with sole_file(Path(path)) as draft:
        figure.savefig(draft, format="png", dpi=dpi, metadata={"Software": None})


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
