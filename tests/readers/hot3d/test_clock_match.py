"""Two clocks aligned by rows that both stamp."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.errors import RecordingUnusable
from prbench.readers.hot3d.to_recording import ClockMatch, match_clocks

OFFSET = 56_833_060_899_305  # ns
START = 56_752_108_188_860


def _device(seconds: float, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A head that never rests, every millisecond."""
    rng = np.random.default_rng(seed)
    time_ns = START + OFFSET + np.arange(int(seconds * 1000)) * 1_000_000
    position = np.cumsum(rng.normal(0.0, 1e-4, (len(time_ns), 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 1e-3, (len(time_ns), 3)), axis=0))
    return time_ns, position, turns.as_quat(scalar_first=True)


def _headset(
    device: tuple[np.ndarray, np.ndarray, np.ndarray], *, drift: float = 0.0, step: float = 1 / 30
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the device at the nearest millisecond, stamped by a clock that runs ``drift`` too fast."""
    since = np.arange(0.0, (len(device[0]) - 2) * 1e-3, step)
    row = np.rint(since * 1000).astype(int)
    return START + np.rint(since * (1 + drift) * 1e9).astype(np.int64), device[1][row], device[2][row]


def _match(headset: tuple, device: tuple) -> ClockMatch:
    return match_clocks(*headset, *device, recording="P0003")


def test_the_offset_is_known_to_a_fraction_of_a_millisecond() -> None:
    device = _device(20.0)
    match = _match(_headset(device), device)
    assert match.matched == match.rows == 600
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns <= 0.2e6
    assert match.drift == 0.0


def test_a_row_says_no_more_than_half_a_step_to_either_side() -> None:
    """Rows exactly on the millisecond all allow the same half millisecond to either side."""
    device = _device(2.0)
    match = _match(_headset(device, step=0.05), device)
    assert match.offset_ns == pytest.approx(OFFSET, abs=1.0)
    assert match.half_width_ns == pytest.approx(0.5e6, abs=1.0)


def test_times_move_from_one_clock_to_the_other_and_stay_integers() -> None:
    device = _device(2.0)
    match = _match(_headset(device), device)
    moved = match.truth_ns(device[0])
    assert moved.dtype == np.int64
    assert np.abs(moved - (device[0] - OFFSET)).max() <= match.half_width_ns + 1


@pytest.mark.parametrize("drift", [20e-6, -20e-6])
def test_a_drift_is_fitted_where_one_offset_does_not_fit(drift: float) -> None:
    device = _device(120.0)
    match = _match(_headset(device, drift=drift), device)
    # The truth runs faster, so that the device falls behind it.
    assert match.drift == pytest.approx(-drift, rel=0.05)
    truth = START + (device[0] - device[0][0]) * (1 + drift)
    assert np.abs(match.truth_ns(device[0]) - truth).max() < 0.5e6
    assert (np.diff(match.truth_ns(device[0])) > 0).all()


def test_rows_at_a_place_that_comes_twice_are_dropped() -> None:
    device = _device(10.0)
    position, rotation = device[1].copy(), device[2].copy()
    position[5000:6000], rotation[5000:6000] = position[4999], rotation[4999]  # the head rests to the last digit
    still = device[0], position, rotation
    match = _match(_headset(still), still)
    assert 265 <= match.matched <= 275, "30 of 300 rows were taken at rest"
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns


def test_rows_of_a_short_rest_are_dropped_and_not_guessed() -> None:
    """Three milliseconds at rest: each of the rows would be near enough, and two of them wrong."""
    device = _device(10.0)
    time_ns, position, rotation = _headset(device)
    row = np.rint((time_ns - START) / 1e6).astype(int)[10::10]
    resting = device[1].copy(), device[2].copy()
    for column in resting:
        column[row - 1] = column[row + 1] = column[row]
    match = _match((time_ns, position, rotation), (device[0], *resting))
    assert match.matched == len(time_ns) - len(row)
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns


def test_a_head_that_hardly_moves_is_found_to_the_last_digit() -> None:
    """Neighbouring rows are closer than a micrometre, but only one is bit-identical."""
    time_ns, position, rotation = _device(10.0)
    slow = time_ns, position * 1e-3, np.tile(rotation[:1], (len(rotation), 1))
    assert _match(_headset(slow), slow).matched == 300


def test_rounded_rows_are_found_as_well() -> None:
    device = _device(10.0)
    time_ns, position, rotation = _headset(device)
    match = _match((time_ns, np.round(position, 7), np.round(rotation, 6)), device)
    assert match.matched > 250
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns


def test_a_stray_match_at_another_time_does_not_spoil_the_offset() -> None:
    device = _device(10.0)
    time_ns, position, rotation = _headset(device)
    position[7], rotation[7] = device[1][9000], device[2][9000]
    match = _match((time_ns, position, rotation), device)
    assert match.matched == len(time_ns) - 1
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns


def test_another_world_is_refused() -> None:
    device = _device(5.0)
    time_ns, position, rotation = _headset(device)
    with pytest.raises(RecordingUnusable, match=r"P0003: .* mm apart \(median\): not one world"):
        _match((time_ns, position + 0.1, rotation), device)


def test_a_smoothed_trajectory_is_refused() -> None:
    """Near, but no row of the trajectory: nothing tells the offset."""
    device = _device(5.0)
    time_ns, position, rotation = _headset(device)
    with pytest.raises(RecordingUnusable, match="0 of 150 headset rows are found"):
        _match((time_ns, position + 2e-5, rotation), device)


def test_a_clock_that_jumps_is_refused() -> None:
    device = _device(20.0)
    time_ns, position, rotation = _headset(device)
    jumped = np.where(np.arange(len(time_ns)) < 400, time_ns, time_ns + 3_000_000)
    with pytest.raises(RecordingUnusable, match="no offset and no drift"):
        _match((jumped, position, rotation), device)


def test_times_without_relation_are_refused() -> None:
    device = _device(20.0)
    time_ns, position, rotation = _headset(device)
    shuffled = np.random.default_rng(1).permutation(len(time_ns))
    with pytest.raises(RecordingUnusable, match="agree about the offset"):
        _match((time_ns, position[shuffled], rotation[shuffled]), device)


def test_a_trajectory_too_coarse_to_tell_is_refused() -> None:
    """One row every 5 ms, and headset rows exactly on them: each allows 2.5 ms to either side."""
    time_ns, position, rotation = _device(20.0)
    coarse = time_ns[::5], position[::5], rotation[::5]
    headset = START + (time_ns[::50] - time_ns[0]), position[::50], rotation[::50]
    with pytest.raises(RecordingUnusable, match=r"uncertain by 5\.00 ms, 1 ms is needed"):
        _match(headset, coarse)
