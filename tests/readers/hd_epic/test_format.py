"""The clock of a video, and the world."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, transform_points
from prbench.readers.hd_epic import format as hd_epic

# Frames 0 to 6 at 30 fps from 100 s on; frame 3 repeats frame 2, and an image is skipped after it.
STEP = 33_333_333
CLOCK = hd_epic.VideoClock(100_000_000_000 + STEP * np.array([0, 1, 2, 2, 4, 5, 6]))


def test_a_repeated_image_and_a_skipped_one() -> None:
    times = CLOCK.device_seconds(np.arange(7.0))
    assert np.diff(times) == pytest.approx(np.array([1, 1, 0, 2, 1, 1]) * STEP / 1e9, abs=1e-9)
    assert CLOCK.repeats == 1


def test_times_between_rows_are_interpolated() -> None:
    assert CLOCK.device_seconds(np.array([0.5, 3.5])) == pytest.approx([100 + 0.5 * STEP / 1e9, 100 + 3 * STEP / 1e9])


def test_beyond_the_last_row_the_frame_rate_goes_on_but_is_not_covered() -> None:
    assert CLOCK.device_seconds(np.array([9.0]))[0] == pytest.approx(100 + 6 * STEP / 1e9 + 3 / 30)
    assert CLOCK.covers(np.array([-0.4, 0.0, 6.0, 6.4, 6.6])).tolist() == [True, True, True, True, False]


def test_the_inverse_names_the_first_frame_of_a_repeat() -> None:
    assert CLOCK.frames(np.array([100 + 2 * STEP / 1e9]))[0] == pytest.approx(2.0, abs=1e-6)


@given(st.floats(0.0, 2.0) | st.floats(4.0, 6.0))
def test_inverse_of_the_inverse(frame) -> None:
    assert CLOCK.frames(CLOCK.device_seconds(np.array([frame])))[0] == pytest.approx(frame, abs=1e-5)


def test_nanoseconds_of_a_long_session_keep_their_microseconds() -> None:
    late = hd_epic.VideoClock(60_000_000_000_123 + STEP * np.arange(3))
    assert late.device_seconds(np.array([1.0]))[0] == pytest.approx(60_000.033333456, abs=1e-9)


def test_z_up_becomes_y_up_without_mirroring() -> None:
    world = Y_UP_FROM_Z_UP
    assert transform_points(world, np.array([1.0, 2.0, 3.0])) == pytest.approx([1.0, 3.0, -2.0])
    assert np.linalg.det(world[:3, :3]) == pytest.approx(1.0)
