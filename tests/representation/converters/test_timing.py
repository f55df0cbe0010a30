"""Other frame rates, by time."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.representation.converters import at_rate, at_times, frames_needed


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
    with pytest.raises(InputFileError, match=r"0\.1 s after 0\.1 s on frame 2"):
        at_times(np.array([0.0, 0.1, 0.1]), np.zeros((3, 3)))
    with pytest.raises(InputFileError, match="at least one"):
        at_times(np.zeros(0), np.zeros((0, 3)))


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan")])
def test_a_rate_that_is_none_is_refused(fps) -> None:
    with pytest.raises(InputFileError, match="frame rate above 0"):
        at_rate(np.zeros((3, 3)), fps)
