"""Where the parts of one sequence stand on a sheet, in inches, so that no text ever meets another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from prbench.shown import figure_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEFT, _STRIP_WIDTH, _STRIP_HEIGHT, _STRIP_STEP = 0.75, 9.55, 1.85, 2.12
_RIGHT, _WAY_SIDE = 11.05, 3.6
_TITLE = 0.6
_CURVES_GAP, _CURVES_HEIGHT, _CURVES_WIDTH, _CURVES_STEP = 0.75, 1.75, 2.75, 3.4
_ROW = 0.24  # of the table of scores
_KEY = 1.15


def block_height(n_motions: int) -> float:
    """Inches that a sequence with so many motions takes."""
    left = _TITLE + n_motions * _STRIP_STEP + _CURVES_GAP + _CURVES_HEIGHT + 0.65
    right = _TITLE + _WAY_SIDE + 0.75 + (n_motions + 1.5) * _ROW + 0.15 + _KEY + 0.3
    return max(left, right)


@dataclass(frozen=True)
class Block:
    """The part of a sheet that belongs to one sequence."""

    figure: Figure
    top: float
    """Inches from the lower edge of the sheet."""
    height: float

    def strip(self, number: int) -> Axes:
        """For the poses of one motion."""
        return self._axes(_LEFT, _TITLE + 0.25 + number * _STRIP_STEP, _STRIP_WIDTH, _STRIP_HEIGHT)

    def curves(self, n_motions: int) -> tuple[Axes, Axes, Axes]:
        """Three beside one another under the poses."""
        down = _TITLE + n_motions * _STRIP_STEP + _CURVES_GAP
        one, two, three = (
            self._axes(_LEFT + number * _CURVES_STEP, down, _CURVES_WIDTH, _CURVES_HEIGHT) for number in range(3)
        )
        return one, two, three

    def way(self) -> Axes:
        """For the view from above."""
        return self._axes(_RIGHT, _TITLE, _WAY_SIDE, _WAY_SIDE)

    def scores(self, n_motions: int) -> Axes:
        """For the table of scores."""
        return self._axes(_RIGHT - 0.35, _TITLE + _WAY_SIDE + 0.75, _WAY_SIDE + 0.5, (n_motions + 1.5) * _ROW)

    def key(self, n_motions: int) -> Axes:
        """For the meaning of lines and marks."""
        down = _TITLE + _WAY_SIDE + 0.75 + (n_motions + 1.5) * _ROW + 0.15
        return self._axes(_RIGHT - 0.35, down, _WAY_SIDE + 0.5, _KEY)

    def text(self, left: float, down: float, text: str, **style: Any) -> None:
        """Write a line whose foot is ``down`` inches under the top."""
        width, height = self.figure.get_size_inches()
        self.figure.text(left / width, (self.top - down) / height, figure_text(text), **style)

    def _axes(self, left: float, down: float, width: float, height: float) -> Axes:
        figure_width, figure_height = self.figure.get_size_inches()
        bottom = self.top - down - height
        place = (left / figure_width, bottom / figure_height, width / figure_width, height / figure_height)
        return self.figure.add_axes(place)
