"""Timelines: nearest samples, gaps, interpolation, rotations, clocks, the sequence grid, and overlap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from prbench.errors import StreamsDoNotOverlap
from prbench.geometry.timelines import (
    SequenceGrid,
    covered,
    interpolate,
    nearest_index,
    require_overlap,
    slerp,
)

TIMES = np.array([0.0, 1.0, 2.0, 10.0, 11.0])
ALL = np.ones(5, dtype=bool)

increasing = st.lists(st.integers(-1000, 1000), min_size=1, max_size=30, unique=True).map(
    lambda ticks: np.array(sorted(ticks)) / 16.0
)
queries = st.lists(st.integers(-1200, 1200), max_size=30).map(lambda ticks: np.array(ticks, dtype=float) / 32.0)


@given(times=increasing, query=queries)
def test_nearest_index_is_that_of_a_full_search(times: np.ndarray, query: np.ndarray) -> None:
    distance = np.abs(times[None] - query[:, None])
    assert nearest_index(times, query).tolist() == distance.argmin(axis=1).tolist()  # argmin: the earlier of two


@pytest.mark.parametrize(
    ("query", "expected"),
    [(0.5, True), (1.0, True), (5.0, False), (10.0, True), (10.5, True), (-0.1, False), (11.1, False), (11.0, True)],
)
def test_nothing_is_covered_across_a_gap_or_beyond_the_ends(query: float, expected: bool) -> None:
    assert covered(TIMES, ALL, np.array([query]), max_gap=1.0) == expected


def test_invalid_samples_leave_a_gap() -> None:
    valid = np.array([True, False, True, True, True])
    query = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    assert covered(TIMES, valid, query, max_gap=1.0).tolist() == [True, False, False, False, True]
    assert covered(TIMES, valid, query, max_gap=2.0).all()
    assert not covered(TIMES, ~ALL, query, max_gap=9.0).any()


def test_a_lonely_sample_covers_its_own_instant() -> None:
    only = np.array([False, False, False, True, False])
    assert covered(TIMES, only, np.array([10.0, 10.0 + 5e-7, 10.1]), max_gap=1.0).tolist() == [True, True, False]


@given(times=increasing, query=queries, seed=st.integers(0, 9))
def test_interpolation_agrees_with_numpy_column_by_column(times: np.ndarray, query: np.ndarray, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(len(times), 2, 3))
    found = interpolate(times, values, query)
    assert found.shape == (len(query), 2, 3)
    for i, j in np.ndindex(2, 3):
        np.testing.assert_allclose(found[:, i, j], np.interp(query, times, values[:, i, j]), atol=1e-12)


def test_interpolation_returns_the_samples_themselves() -> None:
    values = np.random.default_rng(0).normal(size=(5, 3))
    assert (interpolate(TIMES, values, TIMES) == values).all()


def test_slerp_turns_at_constant_speed_on_the_shorter_arc() -> None:
    turns = Rotation.from_euler("y", [[0], [60], [60], [90], [80]], degrees=True).as_quat(scalar_first=True)
    turns[1] *= -1  # the same rotation
    query = np.array([0.25, 0.5, 1.5, 4.0, -3.0, 99.0])
    found = Rotation.from_quat(slerp(TIMES, turns, query), scalar_first=True).as_euler("yxz", degrees=True)[:, 0]
    np.testing.assert_allclose(found, [15, 30, 60, 67.5, 0, 80], atol=1e-9)


def test_slerp_of_one_sample_and_of_no_query() -> None:
    one = np.array([[1.0, 0, 0, 0]])
    assert slerp(np.array([3.0]), one, np.array([0.0, 9.0])).tolist() == [one[0].tolist()] * 2
    assert slerp(TIMES, np.tile(one, (5, 1)), np.empty(0)).shape == (0, 4)


def test_a_sequence_of_three_seconds_and_two_of_lead_at_20_frames_a_second() -> None:
    grid = SequenceGrid.ending_at(13.0, prime_time=10.0, lead=2.0, fps=20.0)
    assert (grid.n_frames, grid.start_time) == (101, 8.0)
    assert grid.times[[0, -1]].tolist() == pytest.approx([8.0, 13.0])


@given(event=st.floats(10, 1e4), gap=st.floats(0, 10), fps=st.sampled_from([20.0, 25.0, 30.0, 60.0]))
def test_the_grid_ends_at_the_event_and_lacks_less_than_one_frame_of_the_span(event, gap, fps) -> None:
    grid = SequenceGrid.ending_at(event, prime_time=event - gap, lead=2.0, fps=fps)
    assert len(grid.times) == grid.n_frames
    assert grid.times[-1] == pytest.approx(event, abs=1e-9)
    missing = grid.times[0] - (event - gap - 2.0)
    assert -2e-6 / fps <= missing < 1 / fps
    np.testing.assert_allclose(np.diff(grid.times), 1 / fps, atol=1e-8)


def test_a_span_of_whole_frames_keeps_its_last_frame_despite_rounding() -> None:
    for event in (0.7, 12.3, 1234.1):
        assert SequenceGrid.ending_at(event, prime_time=event - 0.3, lead=2.0, fps=20.0).n_frames == 47


def test_streams_share_the_latest_start_and_the_earliest_end() -> None:
    ranges = {"gaze": (12.0, 61.3), "body": (11.5, 60.0), "head": (13.0, 70.0)}
    assert require_overlap(ranges, recording="r") == (13.0, 60.0)
    assert require_overlap({"a": (0.0, 1.0), "b": (1.0, 2.0)}, recording="r") == (1.0, 1.0)


def test_the_stream_that_stands_alone_is_named_even_if_its_times_are_too_small() -> None:
    ranges = {"gaze": (11.7, 11.8), "body": (11_712.0, 11_760.0), "objects": (11_712.5, 11_761.0)}
    with pytest.raises(StreamsDoNotOverlap, match="gaze would overlap if its times were 1,000 times as large"):
        require_overlap(ranges, recording="r")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_streams_in_different_units_are_told_apart(factor: float, unit: str) -> None:
    ranges = {"gaze": (12.0, 61.3), "head": (12.5, 61.0), "body": (12.041 * factor, 61.31 * factor)}
    with pytest.raises(StreamsDoNotOverlap, match=f"body would overlap if its times were {unit}") as caught:
        require_overlap(ranges, recording="Apartment_1")
    assert str(caught.value).startswith("Apartment_1: streams do not overlap: head 12.500 … 61.000 s, body 12")


def test_streams_that_no_unit_brings_together() -> None:
    with pytest.raises(StreamsDoNotOverlap, match="No change of unit makes them overlap"):
        require_overlap({"gaze": (1000.0, 1060.0), "body": (2000.0, 2060.0)}, recording="r")
