"""Axes and units of other worlds."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.axes import z_up
from prbench.errors import UsageError
from prbench.representation.converters import to_y_up
from tests.representation.converters.bodies import person

UP = {"x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}


@pytest.mark.parametrize("up", UP)
def test_the_axis_that_points_up_becomes_y_by_a_rotation(up) -> None:
    turned = to_y_up(np.array([UP[up], (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float), up=up)
    assert turned[0].tolist() == [0, 1, 0]
    assert np.linalg.det(turned[1:]) == pytest.approx(1)


def test_z_up_is_the_inverse_of_the_library_s_own_turn() -> None:
    assert np.allclose(to_y_up(z_up(person(5)), up="z"), person(5), atol=0)


def test_camera_coordinates_have_y_down_and_z_forward() -> None:
    assert to_y_up(np.array([[0.2, -1.5, 3.0]]), up="-y").tolist() == [[0.2, 1.5, -3.0]]


@pytest.mark.parametrize("up", UP)
def test_a_left_handed_world_is_mirrored_and_keeps_its_up_axis(up) -> None:
    turned = to_y_up(np.array([UP[up], (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float), up=up, left_handed=True)
    assert turned[0].tolist() == [0, 1, 0]
    assert np.linalg.det(turned[1:]) == pytest.approx(-1)


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("mm", 0.001), (0.5, 0.5)])
def test_units_become_metres(unit, metres) -> None:
    assert to_y_up(np.ones((1, 3)), unit=unit) == pytest.approx(metres)


def test_millimetres_in_whole_numbers_are_not_cut_to_metres() -> None:
    assert to_y_up(np.array([[1, 1450, 3]]), unit="mm").tolist() == [[0.001, 1.45, 0.003]]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"up": "Z"}, "unknown up axis 'Z'.*Did you mean 'z'|unknown up axis"),
        ({"unit": "cms"}, "unknown unit 'cms'. Did you mean 'cm'"),
        ({"unit": 0.0}, "above 0, found 0"),
    ],
)
def test_unknown_axes_and_units_are_refused(words, message) -> None:
    with pytest.raises(UsageError, match=message):
        to_y_up(np.ones((1, 3)), **words)
