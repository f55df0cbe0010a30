"""Charts of the study: bars with intervals (Figure 4), and curves over two limits (Figure S3)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from prbench.errors import UsageError
from prbench.metrics import MAIN_METRICS
from prbench.shown import figure_text
from prbench.tables import Table, metric_column
from prbench.viewing.figures import grid_shape, legend_below, new_figure, styled, write_figure
from prbench.viewing.replay.scene import GAZE_COLOUR, GOAL_COLOUR, METHOD_COLOURS
from prbench_benchmarks.prime_and_reach.study.sweep import Sweep

_COLOURS = (*METHOD_COLOURS, GOAL_COLOUR, GAZE_COLOUR)


@styled
def draw_breakdown(table: Table, path: Path) -> str:
    """Draw Figure 4, a panel for each metric and a colour for each run, with intervals, and return the caption.

    Args:
        table: Result of :func:`prbench_benchmarks.prime_and_reach.study.breakdown.breakdown_table`.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file, or more runs than there are colours.
        StorageError: if the file cannot be written.
    """
    runs = len(table.blocks)
    if runs > len(_COLOURS):
        raise UsageError(f"expected at most {len(_COLOURS)} runs in one figure, found {runs}.")
    shown = {cell.metric for cell in table.cells}
    metrics = [metric_column(info) for info in MAIN_METRICS if info.id in shown]
    groups: dict[str, str] = {}
    for block in table.blocks:
        groups |= {row.text["group"]: f"{row.text['group']}\n{row.text['counts']}" for row in block.rows}
    names = list(groups)
    rows, columns = grid_shape(len(metrics), 3)
    figure = new_figure(2.35 * columns, 1.7 * rows + 0.7, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    width = 0.8 / runs
    for column, place in zip(metrics, axes):
        for number, (block, colour) in enumerate(zip(table.blocks, _COLOURS)):
            bars = {
                names.index(row.text["group"]): cell
                for row in block.rows
                for cell in row.cells
                if cell.metric == column.key
            }
            at = np.array(list(bars)) + (number - (runs - 1) / 2) * width
            means = [cell.value for cell in bars.values()]
            place.bar(at, means, width=0.92 * width, color=colour, alpha=0.75, label=figure_text(block.title))
            for x, cell in zip(at, bars.values()):
                if cell.low is not None and cell.high is not None:
                    place.plot([x, x], [cell.low, cell.high], color="0.15", linewidth=0.8)
        place.set_xticks(range(len(names)), [figure_text(label) for label in groups.values()], fontsize=6)
        place.set_ylim(bottom=0.0)
        place.set_title(figure_text(column.heading))
    for place in axes[len(metrics) :]:
        place.set_axis_off()
    foot = (
        "Lines: 95 % intervals over the recordings (in parentheses) of each group. Groups hold other sequences: overlap"
        " of intervals is no comparison."
    )
    legend_below(figure, axes[0], foot, columns=3)
    figure.suptitle(figure_text(table.title.capitalize()), x=0.01, ha="left")
    caption = f"{table.title.capitalize()}. {foot}"
    write_figure(figure, path, caption)
    return caption


@styled
def draw_sweep(sweeps: Sequence[Sweep], path: Path) -> str:
    """Draw Figure S3, Prime Success over the distance with a curve for each window, and return the caption.

    Args:
        sweeps: One a run.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    from matplotlib import colormaps

    constants = sweeps[0].run.protocol.metrics
    delta = constants.prime_distance
    rows, columns = grid_shape(len(sweeps), 3)
    figure = new_figure(max(2.35 * columns, 3.5), 1.9 * rows + 0.4, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for one, place in zip(sweeps, axes):
        shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(one.windows)))
        for window, rates, shade in zip(one.windows, one.rates, shades, strict=True):
            chosen = window == constants.prime_window
            label = f"σ = {window:g} s{' (protocol)' if chosen else ''}"
            place.plot(one.distances, 100 * rates, color=shade, linewidth=1.8 if chosen else 0.9, label=label)
        place.axvline(delta, color="0.5", linewidth=0.9, linestyle="--")
        place.annotate(f"δ = {delta:g} m", (delta, 100.0), xytext=(3, -2), textcoords="offset points", va="top")
        place.set_xlim(one.distances[0], one.distances[-1])
        place.set_ylim(0.0, 102.0)
        place.set_xlabel("δ (m)")
        place.set_ylabel("Prime Success (%)")
        place.set_title(figure_text(f"{one.run.title}, {one.sequences} sequences"))
        place.grid(visible=True)
    for place in axes[len(sweeps) :]:
        place.set_axis_off()
    axes[0].legend(loc="lower right")
    caption = "Prime Success over distance δ and window σ."
    if any(one.run.record.synthetic for one in sweeps):
        note = "Synthetic people: says nothing about real ones."
        figure.supxlabel(figure_text(note), color="0.35")
        caption = f"{caption} {note}"
    write_figure(figure, path, caption)
    return caption
