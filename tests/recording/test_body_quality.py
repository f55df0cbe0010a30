"""Which body frames are believed."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.recording.streams import plausible_body_frames
from tests.readers.conftest import STANDING

RATE = 120.0


def _walk(n: int) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(n) / RATE
    return times, STANDING + times[:, None, None] * np.array([1.5, 0.0, 0.0])


def _bad(times: np.ndarray, joints: np.ndarray) -> list[int]:
    return np.flatnonzero(~plausible_body_frames(times, joints)).tolist()


def test_a_walk_is_believed() -> None:
    assert _bad(*_walk(240)) == []


@pytest.mark.parametrize("jumped", [[50], [50, 51, 52], [0, 1], [238, 239]], ids=str)
def test_a_whole_body_that_jumps_away_for_some_frames_is_not(jumped) -> None:
    times, joints = _walk(240)
    joints[jumped] += (0.0, 0.0, 0.4)
    assert _bad(times, joints) == jumped


def test_a_body_that_jumps_and_stays_is_believed_on_both_sides() -> None:
    times, joints = _walk(240)
    joints[100:] += (0.0, 0.0, 0.4)
    assert _bad(times, joints) == []


def test_zeros_and_other_bones_are_not_believed() -> None:
    times, joints = _walk(240)
    joints[30] = 0.0
    joints[60:90, 20] += (0.3, 0.0, 0.0)
    joints[120, 3, 1] = np.nan
    assert _bad(times, joints) == [30, *range(60, 90), 120]


def test_a_speed_just_below_ten_metres_a_second_is_a_movement() -> None:
    times, joints = _walk(240)
    fast, slow = joints.copy(), joints.copy()
    fast[50] += (0.0, 0.0, 10.2 / RATE)
    slow[50] += (0.0, 0.0, 9.5 / RATE)
    assert _bad(times, fast) == [50]
    assert _bad(times, slow) == []


def test_two_frames_are_too_few_to_tell_a_jump() -> None:
    times, joints = _walk(2)
    joints[1] += 1.0
    assert _bad(times, joints) == []
