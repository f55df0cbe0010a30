"""Keeping only the rows around wanted times: the same rows as of all of them, and damage anywhere is noticed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from prbench.readers import files
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.trajectory import read_near, read_trajectory
from prbench.readers.files import Source
from tests.readers.mps_files import OTHER_WORLD, WORLD, trajectory_lines, write_lines, zipped

START = 5_000_000_000


def steady(n: int = 3000, step: int = 1000) -> np.ndarray:
    return START + np.arange(n, dtype=np.int64) * step


def chosen(source: Source, gaze_us: np.ndarray) -> mps.AriaTrajectory:
    """The independent way: read everything, then choose."""
    whole = read_trajectory(source)
    wanted = mps.wanted_times_us(gaze_us, int(whole.time_us[0]), int(whole.time_us[-1]))
    return mps.trajectory_rows(whole, mps.rows_around(whole.time_us, wanted))


def require_same(found: mps.AriaTrajectory, expected: mps.AriaTrajectory) -> None:
    for name in ("time_us", "position", "rotation", "quality"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("search")


STEPS = st.lists(st.sampled_from([1, 7, 998, 1000, 1002, 1179, 60_000, 2_000_000]), min_size=0, max_size=400)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=STEPS,
    wanted=st.lists(st.integers(-5_000, 3_000_000), max_size=60),
    exactly=st.lists(st.integers(0, 400), max_size=60),
    block=st.sampled_from([600, 2_000, 2**20]),
    end=st.sampled_from(["\n", "\r\n"]),
    last_end=st.sampled_from(["\n", "\n\n\n"]),
    archived=st.booleans(),
)
def test_the_same_rows_as_reading_all_of_them(folder, steps, wanted, exactly, block, end, last_end, archived) -> None:
    times = START + np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    path = write_lines(folder / "t.csv", trajectory_lines(times), end=end, last_end=last_end)
    gaze_us = np.sort(
        np.append(START + np.array(wanted, dtype=np.int64), times[np.array(exactly, dtype=int) % len(times)])
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "_BLOCK", block)
        found = read_near(zipped(path) if archived else path, gaze_us)
    require_same(found, chosen(path, gaze_us))


@pytest.mark.parametrize("archived", [False, True], ids=["plain", "zipped"])
def test_uneven_steps_gaps_and_lengths_in_a_longer_file(folder, archived, monkeypatch) -> None:
    monkeypatch.setattr(files, "_BLOCK", 2**14)
    rng = np.random.default_rng(4)
    steps = np.where(rng.random(20_000) < 0.001, 400_000, rng.integers(1, 1180, 20_000))
    path = write_lines(folder / "long.csv", trajectory_lines(START + np.cumsum(steps)))
    gaze_us = START + np.arange(0, 12_000_000, 99_991)
    found = read_near(zipped(path) if archived else path, gaze_us)
    require_same(found, chosen(path, gaze_us))
    assert len(found.time_us) < 2500


def test_rows_on_both_sides_by_hand(folder) -> None:
    path = write_lines(folder / "hand.csv", trajectory_lines(np.array([10, 20, 30, 40, 50, 60])))
    assert read_near(path, np.array([34, 41])).time_us.tolist() == [10, 30, 40, 50, 60]
    assert read_near(path, np.array([20])).time_us.tolist() == [10, 20, 60]
    assert mps.rows_around(np.array([10, 20, 30]), np.array([34, 20, -7])).tolist() == [0, 1, 2]


def test_the_grid_begins_with_the_trajectory_and_covers_its_end() -> None:
    wanted = mps.wanted_times_us(np.array([START - 5, START + 40_000, START + 10**9]), START, START + 100_000)
    assert (wanted - START).tolist() == [0, 33_333, 40_000, 66_667, 100_000]
    assert mps.wanted_times_us(np.array([], dtype=np.int64), START, START + 5).max() >= START + 5
    later = mps.wanted_times_us(np.array([START + 40_000]), START, START + 100_000, from_us=START + 40_000)
    assert (later - START).tolist() == [66_667, 100_000]


def test_rows_without_a_world_or_of_a_shorter_one_are_left_out(folder) -> None:
    worlds = [WORLD] * 2000 + [mps.UNDEFINED_GRAPH] * 400 + [OTHER_WORLD] * 600
    path = write_lines(folder / "worlds.csv", trajectory_lines(steady(), worlds=worlds))
    thin = read_near(path, np.array([START + 500]))
    assert thin.graph_uids == (WORLD, OTHER_WORLD)
    assert thin.time_us.max() < START + 2_000_000
    assert thin.left_out > 0


def test_quoted_text_is_read_too(folder) -> None:
    lines = trajectory_lines(steady(50))
    quoted = [lines[0], *(line.replace(WORLD, f'"{WORLD}"', 1) for line in lines[1:])]
    path = write_lines(folder / "quoted.csv", quoted)
    assert read_near(path, steady(50)).time_us.tolist() == steady(50).tolist()
