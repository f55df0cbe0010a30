"""Durations, gaps and movements of synthetic sequences as histograms, beside what the study reports of real ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prbench.locks import sole_file
from prbench.published import Spread
from prbench.synthetic.performance import Performance
from prbench.synthetic.statistics import TARGETS, clips_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLUMNS = (("duration", "s", 14.0), ("gap", "s", 12.0), ("body", "m", 6.0), ("hand", "m", 1.5))


def render_histograms(performances: Mapping[str, Sequence[Performance]], path: Path | str, *, dpi: int = 80) -> None:
    """Draw one row of four histograms for every preset; the shaded band is the study's mean and spread.

    Args:
        performances: Recordings of each preset.
        path: PNG to write; replaced when it exists.
        dpi: Resolution.

    Raises:
        ValueError: if there is no preset.
        StorageError: if the file cannot be written.
    """
    if not performances:
        raise ValueError("expected the performances of at least one preset, found none")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.0, 2.3 * len(performances)), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(performances), len(_COLUMNS), squeeze=False)
    for row, (preset, acted) in zip(grid, performances.items(), strict=True):
        clips = clips_of(acted)
        gaps = np.array([clip.event.event_time - clip.start - clip.prime_after for clip in clips])
        movements = np.array([(clip.body_movement, clip.hand_movement) for clip in clips]).reshape(-1, 2)
        for axes, values, column in zip(row, (gaps + 2.0, gaps, *movements.T), _COLUMNS, strict=True):
            name, unit, highest = column
            _draw(axes, values, getattr(TARGETS[preset], name), highest)
            axes.set_title(f"{preset}: {name} ({unit}), {len(clips)} synthetic sequences", fontsize=7)
    with sole_file(Path(path)) as draft:
        figure.savefig(draft, format="png", dpi=dpi, metadata={"Software": None})


def _draw(axes: Axes, values: np.ndarray, target: Spread, highest: float) -> None:
    axes.axvspan(target.mean - target.sd, target.mean + target.sd, color="0.92")
    axes.axvline(target.mean, color="0.4", linewidth=1.0)
    axes.hist(np.minimum(values, highest), bins=np.linspace(0.0, highest, 29).tolist(), color="tab:blue", alpha=0.7)
    if values.size:
        axes.axvline(float(values.mean()), color="tab:blue", linewidth=1.0)
    axes.set_xlim(0.0, highest)
    axes.tick_params(labelsize=6)
