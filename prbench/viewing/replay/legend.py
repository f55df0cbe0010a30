"""The table of scores, and what lines and marks mean."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from prbench.shown import figure_text
from prbench.viewing.replay import palette
from prbench.viewing.replay.captions import HEADER, score_row
from prbench.viewing.replay.scene import Scene

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_COLUMNS = (0.0, 0.47, 0.59, 0.71, 0.83, 0.925, 1.02)  # of the table's width: right edges, but for the first
_LABEL = 26  # characters of a label that fit


def draw_scores(axes: Axes, scene: Scene) -> None:
    """One row a motion: Prime Success, Reach Success, nearest wrist, Location Error, Goal MPJPE, MPJPE."""
    axes.set_axis_off()
    rows = [HEADER, *(score_row(scene, motion) for motion in scene.motions)]
    colours = ["0.35", *(motion.colour for motion in scene.motions)]
    for number, (row, colour) in enumerate(zip(rows, colours, strict=True)):
        height = 1.0 - (number + 1.0) / (len(rows) + 0.5)
        for column, (place, text) in enumerate(zip(_COLUMNS, row, strict=True)):
            shown = text if len(text) <= _LABEL else f"{text[: _LABEL - 1]}…"
            side = "left" if column == 0 else "right"
            style: dict[str, Any] = {"ha": side, "va": "center", "fontsize": 7.5 if number else 7, "color": colour}
            axes.text(place, height, figure_text(shown), transform=axes.transAxes, **style)


def draw_key(axes: Axes, scene: Scene) -> None:
    """What lines and marks mean."""
    axes.set_axis_off()
    handles = key_handles(scene)
    axes.legend(handles=handles, fontsize=7.2, ncols=2, frameon=False, loc="upper left", borderaxespad=0.0)


def key_handles(scene: Scene) -> list[Artist]:
    """Of the lines and marks that this sequence's picture has."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grey: dict[str, Any] = {"color": palette.MARK}
    handles: list[Artist] = [
        Line2D([], [], linewidth=2.1, label="right limbs and trunk (left: thin)", **grey),
        Line2D([], [], linewidth=1.1, linestyle=(0, (4, 2)), label="head ray", **grey),
    ]
    if scene.gaze is not None and scene.shows_recorded:
        handles.append(Line2D([], [], linewidth=1.5, color=palette.GAZE, label="recorded gaze"))
    if scene.goal is not None:
        handles.append(Line2D([], [], marker="s", linestyle="", color=palette.GOAL, label="goal and its box"))
    handles += [
        Line2D([], [], marker="o", linestyle="", markersize=5, label="first frame", **grey),
        Line2D([], [], marker="D", linestyle="", markersize=5, label="at prime time", **grey),
        Line2D([], [], marker="*", linestyle="", markersize=9, label="at the event", **grey),
        Patch(facecolor="0.88", label=f"prime time ± {scene.thresholds.prime_window:g} s"),
    ]
    if scene.surroundings is not None:
        dots: dict[str, Any] = {"linestyle": "", "markersize": 2, "color": palette.SURROUNDINGS}
        handles.append(Line2D([], [], marker="o", label="what stood around at the event", **dots))
    return handles
