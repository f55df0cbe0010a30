"""Where the parts of a film's picture stand, as shares of its width and height."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEFT, _WIDTH = 0.04, 0.56
_BOTTOM, _TOP = 0.09, 0.895


def side_panels(figure: Figure, n_motions: int) -> list[Axes]:
    """One panel a motion, in as many columns as keep them large: one up to two motions, two up to six, else three."""
    columns = 1 if n_motions <= 2 else 2 if n_motions <= 6 else 3
    rows = -(-n_motions // columns)
    width, height = _WIDTH / columns, (_TOP - _BOTTOM) / rows
    return [
        figure.add_axes(
            (
                _LEFT + (number % columns) * width,
                _TOP - (number // columns + 1) * height + 0.035,
                width - 0.025,
                height - 0.065,
            )
        )
        for number in range(n_motions)
    ]


def fit_limits(axes: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
    """Show at least this range, a metre being as long across as up; what is left over goes to the sides or above."""
    figure = axes.get_figure(root=True)
    assert figure is not None, "the axes stand in a figure"
    place = axes.get_position()
    ratio = (place.width * figure.get_figwidth()) / (place.height * figure.get_figheight())
    width, height = across[1] - across[0], up[1] - up[0]
    more_across, more_up = max(height * ratio - width, 0.0), max(width / ratio - height, 0.0)
    axes.set_xlim(across[0] - more_across / 2, across[1] + more_across / 2)
    axes.set_ylim(up[0], up[1] + more_up)


def top_panel(figure: Figure) -> Axes:
    """A square for the view from above."""
    return figure.add_axes((0.66, 0.47, 0.25, 0.445))


def curve_panels(figure: Figure) -> tuple[Axes, Axes]:
    """Head and wrist against the goal, over time."""
    return figure.add_axes((0.65, 0.27, 0.33, 0.12)), figure.add_axes((0.65, 0.09, 0.33, 0.12))
