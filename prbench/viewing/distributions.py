"""Histograms of built datasets beside the study's numbers: Figure S2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from prbench.datasets import SYNTHETIC_PREFIX, imitated
from prbench.protocol.published import load_table_one
from prbench.sequences.table import TableStatistics
from prbench.shown import figure_text
from prbench.viewing.figures import new_figure, require_drawable, styled, write_figure
from prbench.viewing.replay.scene import METHOD_COLOURS as _COLOURS

_BINS = 30
# Height of a panel over that of its bars, so that no legend lies on a bar.
_HEADROOM = 1.2


@styled
def draw_table_one(statistics: Sequence[TableStatistics], path: Path) -> str:
    """Draw goal distance, elevation and azimuth, body movement, gaze shift and prime gap.

    Histograms show densities, so that datasets of different size can be compared. The published mean and spread of the
    dataset stand behind body movement and prime gap, where one dataset is drawn.

    Args:
        statistics: One or several datasets, drawn over one another.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    require_drawable(path)
    figure = new_figure(7.0, 3.9, layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    # The published band belongs to one dataset; behind several it would be read as that of all.
    only = statistics[0] if len(statistics) == 1 else None
    published = None if only is None else load_table_one().get(imitated(only.dataset))
    for number, quantity, title in (
        (0, "goal_distance", "a  goal distance (m)"),
        (1, "goal_elevation_deg", "b  goal elevation (deg)"),
        (2, "goal_azimuth_deg", "c  goal azimuth (deg, left positive)"),
        (3, "body_movement", "d  body movement (m)"),
        (5, "prime_gap", "f  prime gap (s)"),
    ):
        panel = panels[number]
        values = [getattr(each, quantity) for each in statistics]
        together = np.concatenate(values)
        low = float(together.min())
        high = float(together.max())
        # Common edges for all datasets; a quantity without spread still needs a bin of some width.
        edges = np.linspace(low, high, _BINS + 1) if low < high else np.linspace(low - 0.5, low + 0.5, _BINS + 1)
        band = getattr(published, quantity, None)  # the study prints body movement and prime gap of these
        if band is not None:
            synthetic = statistics[0].dataset.startswith(SYNTHETIC_PREFIX)
            label = f"published mean{' of real people' if synthetic else ''}, sd shaded"
            panel.axvspan(band.mean - band.sd, band.mean + band.sd, color="0.92")
            panel.axvline(band.mean, color="0.4", linewidth=1.0, label=label)
            panel.legend(fontsize=6)
        for colour, each in zip(_COLOURS, values, strict=False):
            panel.hist(each, bins=edges.tolist(), density=True, color=colour, alpha=0.7 if len(values) == 1 else 0.4)
            panel.axvline(float(each.mean()), color=colour, linewidth=1.0)
        panel.set_title(title)
        panel.set_yticks([])
        panel.set_ylim(top=_HEADROOM * panel.get_ylim()[1])
    for colour, each in zip(_COLOURS, statistics, strict=False):
        low, median, high = each.gaze_shift_deg.T
        panels[4].fill_between(each.gaze_shift_times, low, high, color=colour, alpha=0.2)
        panels[4].plot(each.gaze_shift_times, median, color=colour, linewidth=1.2)
        label = figure_text(f"{each.dataset}, {each.sequences} sequences")
        panels[0].plot([], [], color=colour, linewidth=4, label=label)
    panels[4].axvline(0.0, color="0.6", linewidth=0.8)
    panels[4].set_ylim(bottom=0.0)
    panels[4].set_title("e  gaze off the goal (deg), around the prime")
    panels[0].legend(fontsize=6)
    tables = ", ".join(f"{each.dataset} ({each.sequences} sequences)" for each in statistics)
    grey = "" if published is None else " Grey: published mean and standard deviation."
    caption = f"Sequences of {tables}: a to c, place of the goal from the first pose; d, how far the body moves; e,"
    caption += " angle between gaze and goal around the prime time, median and quartiles; f, time from the prime to the"
    caption += f" event. Densities; vertical lines are means.{grey}"
    write_figure(figure, path, caption)
    return caption
