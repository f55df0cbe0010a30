"""Axes and units of other worlds."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError, UsageError
from prbench.geometry.skeleton import z_up
from prbench.representation.converters import at_rate, at_times, frames_needed, to_y_up
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


def line(times: np.ndarray) -> np.ndarray:
    """A point that moves at 1, 2 and 3 m/s."""
    return times[:, None] * np.array([1.0, 2.0, 3.0])


@pytest.mark.parametrize("fps", [12.5, 20.0, 29.97, 30.0, 60.0, 100.0, 120.0])
def test_any_rate_comes_to_the_same_motion_at_20_fps(fps) -> None:
    wanted = 101
    n = frames_needed(wanted, fps)
    got = at_rate(line(np.arange(n) / fps), fps, n_frames=wanted)
    assert np.allclose(got, line(np.arange(wanted) / 20), atol=1e-9)
    with pytest.raises(InputFileError, match=r"5\.000 s of motion"):  # one frame fewer does not cover it
        at_rate(line(np.arange(n - 1) / fps), fps, n_frames=wanted)


def test_every_third_frame_of_59_fps_would_be_another_motion() -> None:
    n = 60
    by_index = line(np.arange(n) / 59)[::2]
    by_time = at_rate(line(np.arange(n) / 59), 59.0)
    assert np.abs(by_index[:20] - by_time[:20]).max() > 0.9  # 19 frames later it is a third of a second behind


def test_as_many_frames_as_the_motion_covers() -> None:
    assert len(at_rate(np.zeros((31, 2)), 30.0)) == 21
    assert len(at_rate(np.zeros((30, 2)), 30.0)) == 20
    assert len(at_rate(np.zeros((1, 2)), 30.0)) == 1


def test_uneven_times_are_taken_as_they_are() -> None:
    times = 7.0 + np.array([0.0, 0.04, 0.11, 0.2, 0.31])
    assert np.allclose(at_times(times, line(times)), line(7.0 + np.arange(7) / 20))


def test_times_that_stand_still_are_named() -> None:
    with pytest.raises(InputFileError, match=r"frame 2: expected increasing times, after 0\.1 s, found 0\.1 s"):
        at_times(np.array([0.0, 0.1, 0.1]), np.zeros((3, 3)))
    with pytest.raises(InputFileError, match="at least one"):
        at_times(np.zeros(0), np.zeros((0, 3)))


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan")])
def test_a_rate_that_is_none_is_refused(fps) -> None:
    with pytest.raises(InputFileError, match="frame rate above 0"):
        at_rate(np.zeros((3, 3)), fps)
