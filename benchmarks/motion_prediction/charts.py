"""The figure of the study of motion prediction: error over the horizon, and what gaze is worth before the event."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prbench.errors import UsageError
from prbench.shown import figure_text
from prbench.tables import Cell, Table
from prbench.viewing.figures import new_figure, require_drawable, styled, write_figure

_MARKERS = "osD^vP*X<"
_LEAD = "windows: event-"  # how the variant of a difference ends for windows so many seconds before the event


@styled
def draw_prediction(tables: Sequence[Table], path: Path) -> str:
    """Draw the mean error up to each horizon, and its change when more is told; return the caption.

    Args:
        tables: Tables of :func:`prbench_benchmarks.motion_prediction.study_tables.prediction_tables`. The second panel
            needs anchored windows and a method under several conditions.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file, or if no row was measured.
        StorageError: if the file cannot be written.
    """
    require_drawable(path)
    horizons: dict[str, list[tuple[float, Cell]]] = {}
    values: dict[str, list[tuple[float, Cell]]] = {}
    for table in tables:
        for row in (row for block in table.blocks for row in block.rows):
            for cell in row.cells:
                name, _, seconds = cell.metric.partition("@")
                # Tables 1 and 2 share rows; the ablations of Table 3 would crowd the panel.
                point = (float(seconds[:-1]), cell) if name == "ade" and seconds.endswith("s") else None
                if point and table.number in ("1", "2") and point not in horizons.setdefault(row.text["method"], []):
                    horizons[row.text["method"]].append(point)
                metric, _, lead = cell.variant.partition(f", {_LEAD}")
                if cell.metric == "difference" and metric == "ade" and lead:
                    values.setdefault(f"{cell.method}: {cell.condition}", []).append((float(lead), cell))
    panels = [
        (horizons, "error up to the horizon, best sample (m)", "seconds after the last observed frame"),
        (values, "change when more is told (m)", "seconds before the event"),
    ]
    panels = [panel for panel in panels if panel[0]]
    if not panels:
        raise UsageError(f"{path}: nothing to draw, since no row was measured.")
    figure = new_figure(7.0, 3.2 * len(panels), layout="constrained")
    for axes, (lines, title, x_title) in zip(figure.subplots(len(panels), squeeze=False)[:, 0], panels):
        for number, (label, points) in enumerate(lines.items()):
            places = [at + 0.01 * (number - len(lines) / 2) for at, _ in points]  # so that intervals stand apart
            means = [cell.value for _, cell in points]
            marker = _MARKERS[number % len(_MARKERS)]
            (line,) = axes.plot(places, means, f"{marker}-", markersize=3, linewidth=0.9, label=figure_text(label))
            for place, (_, cell) in zip(places, points):
                if cell.low is not None and cell.high is not None:
                    axes.plot([place, place], [cell.low, cell.high], color=line.get_color(), linewidth=0.7)
        axes.set_title(title)
        axes.set_xlabel(x_title)
        axes.legend(fontsize=6, loc="center left", bbox_to_anchor=(1.0, 0.5))
        if lines is values:
            axes.axhline(0.0, color="0.6", linewidth=0.9)
            axes.invert_xaxis()
    said = "Lines: 95 % intervals over recordings."
    figure.supxlabel(said, color="0.35", x=0.01, ha="left")
    caption = f"Motion prediction: {'; '.join(title for _, title, _ in panels)}. {said}"
    write_figure(figure, path, caption)
    return caption
