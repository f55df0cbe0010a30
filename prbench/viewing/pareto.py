"""Scores against cost: which methods nobody beats in both."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.errors import UsageError
from prbench.shown import figure_text
from prbench.viewing.figures import new_figure, require_drawable, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LABEL_GAP = 6  # points between a mark and its name


@dataclass(frozen=True)
class ScoredMethod:
    """One method in the plot."""

    name: str
    """Its name and condition."""
    score: float
    """Mean in the printed unit, rates in %."""
    low: float | None
    """Lower bound of the mean's interval, where there is one."""
    high: float | None
    """Upper bound of the interval."""
    cost: float | None
    """Cost in the printed unit; None for a control, which is drawn as a level line."""


@dataclass(frozen=True)
class ParetoAxes:
    """What the axes show."""

    title: str
    score: str
    cost: str
    higher_is_better: bool


def pareto_front(methods: Sequence[ScoredMethod], *, higher_is_better: bool) -> tuple[ScoredMethod, ...]:
    """Return the methods with a cost that no other one beats in score at the same or a lower cost, cheapest first.

    Args:
        methods: Any number of methods; those without cost are left out.
        higher_is_better: Direction of the score.
    """
    sign = 1 if higher_is_better else -1
    # Of equally cheap ones the best comes first, so that the others do not stand on the front.
    measured = [each for _, each in sorted(_with_cost(methods), key=lambda pair: (pair[0], -sign * pair[1].score))]
    front: list[ScoredMethod] = []
    for each in measured:
        if not front or sign * each.score > sign * front[-1].score:
            front.append(each)
    return tuple(front)


def _with_cost(methods: Iterable[ScoredMethod]) -> list[tuple[float, ScoredMethod]]:
    return [(each.cost, each) for each in methods if each.cost is not None]


def draw_pareto(methods: Sequence[ScoredMethod], axes: ParetoAxes, path: Path, *, dpi: int = 110) -> None:
    """Draw scores with their intervals against cost, the front as steps, and controls as level lines.

    Args:
        methods: One mark each.
        axes: Titles and direction.
        path: ``.png`` or ``.svg``; replaced when it exists.
        dpi: Resolution of a PNG.

    Raises:
        UsageError: for another kind of file, or if no method has a cost.
        StorageError: if the file cannot be written.
    """
    require_drawable(path)
    if all(each.cost is None for each in methods):
        raise UsageError("nothing to draw: none of the methods has a measured cost (controls and files have none).")
    figure = new_figure(7.2, 4.6, dpi=dpi, layout="constrained")
    panel = figure.subplots()
    front = pareto_front(methods, higher_is_better=axes.higher_is_better)
    measured = _with_cost(methods)
    for cost, each in measured:
        on_front = each in front
        colour = "tab:blue" if on_front else "0.55"
        if each.low is not None and each.high is not None:
            panel.vlines(cost, each.low, each.high, color=colour, linewidth=1.0, alpha=0.6)
        panel.plot([cost], [each.score], "o", color=colour, markersize=6)
        panel.annotate(
            figure_text(each.name),
            (cost, each.score),
            xytext=(_LABEL_GAP, _LABEL_GAP),
            textcoords="offset points",
            fontsize=8,
            color=colour,
        )
    if len(front) > 1:
        costs = [cost for cost, _ in _with_cost(front)]
        panel.step(costs, [each.score for each in front], where="post", color="tab:blue", linewidth=1.0, linestyle="--")
    _draw_levels(panel, [each for each in methods if each.cost is None])
    if all(cost > 0 for cost, _ in measured):
        panel.set_xscale("log")
        panel.margins(x=0.25)
    panel.set_xlabel(axes.cost)
    panel.set_ylabel(axes.score)
    panel.set_title(figure_text(axes.title), fontsize=9)
    panel.grid(visible=True, alpha=0.25)
    write_figure(figure, path)


def _draw_levels(panel: Axes, controls: Sequence[ScoredMethod]) -> None:
    """Draw controls of one score as one line with all their names."""
    for score in sorted({each.score for each in controls}):
        names = ", ".join(each.name for each in controls if each.score == score)
        panel.axhline(score, color="tab:orange", linewidth=0.9, linestyle=":")
        panel.annotate(
            figure_text(names),
            (1.0, score),
            xycoords=("axes fraction", "data"),
            xytext=(4, 0),  # beside the panel, where no method's name is
            textcoords="offset points",
            va="center",
            fontsize=7,
            color="tab:orange",
        )
