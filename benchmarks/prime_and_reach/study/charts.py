"""Charts of the study: bars with intervals (Figure 4), and curves over two limits (Figure S3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.shown import figure_text
from prbench.viewing.figures import grid_shape, new_figure, require_drawable, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown", "tab:pink", "tab:olive")
MOST_RUNS = len(_COLOURS)
"""Runs of one chart: each has a colour of its own."""
_NOTE_SIZE = 7


@dataclass(frozen=True)
class Bar:
    """One bar with its interval, in the printed unit."""

    run: str
    group: str
    mean: float
    low: float | None
    high: float | None
    count: str
    """Sequences and recordings behind it, in words."""


@dataclass(frozen=True)
class BarPanel:
    """One metric: bars by group, a colour for each run."""

    title: str
    bars: tuple[Bar, ...]


@dataclass(frozen=True)
class CurvePanel:
    """One run: a curve for each window."""

    title: str
    distances: tuple[float, ...]
    """δ, metres: the horizontal axis."""
    windows: tuple[float, ...]
    """σ, seconds: one curve each."""
    percent: Float[np.ndarray, "windows distances"]


def draw_bars(panels: Sequence[BarPanel], path: Path, *, title: str, foot: str = "", dpi: int = 110) -> None:
    """Draw metrics side by side, groups along the axis, and an interval on every bar.

    Args:
        panels: One a metric.
        path: ``.png`` or ``.svg``; replaced when it exists.
        title: What is shown.
        foot: What a reader has to know, under the panels.
        dpi: Resolution of a PNG.

    Raises:
        ValueError: without panels, or with more runs than there are colours.
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    require_drawable(path)
    runs = list(dict.fromkeys(bar.run for panel in panels for bar in panel.bars))
    if not panels or len(runs) > MOST_RUNS:
        raise ValueError(f"expected panels of 1 to {MOST_RUNS} runs, found {len(panels)} panels of {len(runs)} runs")
    rows, columns = grid_shape(len(panels), 3)
    figure = new_figure(4.3 * columns, 3.0 * rows + 0.9, dpi=dpi, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, place in zip(panels, axes):
        _draw_panel(place, panel, runs)
    for place in axes[len(panels) :]:
        place.set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    # The note is the legend's title, because a note of its own at the lower edge would be drawn over the legend.
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=min(len(labels), 3),
        fontsize=8,
        frameon=False,
        title=figure_text(foot),
        title_fontsize=_NOTE_SIZE,
    )
    figure.suptitle(figure_text(title), fontsize=10, x=0.01, ha="left")
    write_figure(figure, path)


def _draw_panel(axes: Axes, panel: BarPanel, runs: Sequence[str]) -> None:
    groups = list(dict.fromkeys(bar.group for bar in panel.bars))
    width = 0.8 / len(runs)
    counts = {bar.group: bar.count for bar in panel.bars}
    for number, (run, colour) in enumerate(zip(runs, _COLOURS)):
        own = [bar for bar in panel.bars if bar.run == run]
        places = np.array([groups.index(bar.group) for bar in own]) + (number - (len(runs) - 1) / 2) * width
        means = np.array([bar.mean for bar in own])
        axes.bar(places, means, width=0.92 * width, color=colour, alpha=0.75, label=figure_text(run))
        for place, bar in zip(places, own):
            if bar.low is not None and bar.high is not None:
                axes.plot([place, place], [bar.low, bar.high], color="0.15", linewidth=1.1)
    axes.set_xticks(range(len(groups)), [figure_text(f"{group}\n{counts[group]}") for group in groups], fontsize=7)
    axes.tick_params(axis="y", labelsize=7)
    axes.set_ylim(bottom=0.0)
    axes.set_title(figure_text(panel.title), fontsize=9, loc="left")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def draw_sweeps(
    panels: Sequence[CurvePanel], path: Path, *, title: str, limits: tuple[float, float], foot: str = "", dpi: int = 110
) -> None:
    """Draw Prime Success over the distance, a curve for each window.

    Args:
        panels: One a run and dataset.
        path: ``.png`` or ``.svg``; replaced when it exists.
        title: What is shown.
        limits: The protocol's δ and σ, which are marked.
        foot: What a reader has to know, under the panels.
        dpi: Resolution of a PNG.

    Raises:
        ValueError: without panels.
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    require_drawable(path)
    if not panels:
        raise ValueError("expected one panel or more, found none")
    from matplotlib import colormaps

    rows, columns = grid_shape(len(panels), 3)
    figure = new_figure(4.6 * columns, 3.4 * rows + 0.6, dpi=dpi, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for panel, place in zip(panels, axes):
        shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(panel.windows)))
        for window, percent, shade in zip(panel.windows, panel.percent, shades, strict=True):
            chosen = window == limits[1]
            label = f"σ = {window:g} s{' (protocol)' if chosen else ''}"
            place.plot(panel.distances, percent, color=shade, linewidth=2.2 if chosen else 1.3, label=label)
        place.axvline(limits[0], color="0.5", linewidth=0.9, linestyle="--")
        place.annotate(
            f"δ = {limits[0]:g} m", (limits[0], 100.0), xytext=(3, -2), textcoords="offset points", fontsize=7, va="top"
        )
        place.set_xlim(panel.distances[0], panel.distances[-1])
        place.set_ylim(0.0, 102.0)
        place.set_xlabel("δ (m)", fontsize=8)
        place.set_ylabel("Prime Success (%)", fontsize=8)
        place.tick_params(labelsize=7)
        place.set_title(figure_text(panel.title), fontsize=9, loc="left")
        place.grid(visible=True, color="0.9")
    for place in axes[len(panels) :]:
        place.set_axis_off()
    axes[0].legend(fontsize=7, frameon=False, loc="lower right")
    figure.suptitle(figure_text(title), fontsize=10, x=0.01, ha="left")
    if foot:
        figure.supxlabel(figure_text(foot), fontsize=_NOTE_SIZE, color="0.35")
    write_figure(figure, path)
