"""Charts of motion prediction: error over the horizon, and what gaze is worth over the time before the event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.errors import UsageError
from prbench.shown import figure_text
from prbench.viewing.figures import new_figure, require_drawable, write_figure

_COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#999933",
    "#882255",
    "#56b4e9",
    "#e69f00",
    "#555555",
    "#000000",
)
_MARKERS = "osD^vP*X<"
"""One less than the colours, so that colour and mark together repeat late."""


@dataclass(frozen=True)
class ChartPoint:
    """A mean with its interval at one place of the x axis."""

    at: float
    mean: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class ChartPanel:
    """One panel."""

    title: str
    x: str
    y: str
    lines: Mapping[str, Sequence[ChartPoint]]
    """Points of each line by its label, in the order of the legend."""
    ruled_at: float | None = None
    """Where a level line marks no difference."""
    reversed_x: bool = False


def draw_chart(panels: Sequence[ChartPanel], path: Path, *, note: str = "", dpi: int = 110) -> None:
    """Draw panels side by side, with one legend for all.

    Args:
        panels: One or more, with something in one of them.
        path: ``.png`` or ``.svg``; replaced when it exists.
        note: Sentence below the panels.
        dpi: Resolution of a PNG.

    Raises:
        UsageError: for another kind of file, or if there is nothing to draw.
        StorageError: if the file cannot be written.
    """
    require_drawable(path)
    panels = [panel for panel in panels if any(panel.lines.values())]
    if not panels:
        raise UsageError(f"{path}: nothing to draw: no line has a point.")
    labels = list(dict.fromkeys(label for panel in panels for label in panel.lines))
    figure = new_figure(5.0 * len(panels) + 2.4, 4.2, dpi=dpi, layout="constrained")
    handles = {}
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        if panel.ruled_at is not None:
            axes.axhline(panel.ruled_at, color="0.6", linewidth=0.9)
        # How far lines stand apart at one place, so that their intervals do not cover one another.
        places = sorted({point.at for points in panel.lines.values() for point in points})
        closest = min(np.diff(places), default=1.0)
        spread = 0.35 * float(closest) / max(len(panel.lines), 1) * 0.5
        for label, points in panel.lines.items():
            number = labels.index(label)
            place = np.array([point.at for point in points]) + spread * (number - (len(labels) - 1) / 2)
            mean = np.array([point.mean for point in points])
            (handle,) = axes.plot(
                place,
                mean,
                color=_COLOURS[number % len(_COLOURS)],
                marker=_MARKERS[number % len(_MARKERS)],
                markersize=5,
                linewidth=1.3,
            )
            for x, point in zip(place, points, strict=True):
                if point.low is not None and point.high is not None:
                    axes.plot([x, x], [point.low, point.high], color=handle.get_color(), linewidth=1.0, alpha=0.7)
            handles[label] = handle
        axes.set_title(figure_text(panel.title), fontsize=9, loc="left")
        axes.set_xlabel(figure_text(panel.x), fontsize=8)
        axes.set_ylabel(figure_text(panel.y), fontsize=8)
        axes.set_xticks(sorted({point.at for points in panel.lines.values() for point in points}))
        axes.tick_params(labelsize=7)
        if panel.reversed_x:
            axes.invert_xaxis()
    shown = [label for label in labels if label in handles]
    figure.legend(
        [handles[label] for label in shown],
        [figure_text(label) for label in shown],
        loc="outside right upper",
        fontsize=7.5,
        frameon=False,
    )
    if note:
        figure.supxlabel(figure_text(note), fontsize=7, color="0.35", x=0.01, ha="left")
    write_figure(figure, path)
