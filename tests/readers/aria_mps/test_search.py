"""Reading only the rows around wanted times: the same rows as reading all of them, and what it cannot notice."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from prbench.errors import InputFileError
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.search import NearGaze, NotSearchable, search_rows
from prbench.readers.aria_mps.trajectory import COLUMNS, check_trajectory, read_near
from prbench.readers.files import Source, read_columns
from tests.readers.mps_files import OTHER_WORLD, WORLD, NearTimes, trajectory_lines, write_lines, zipped

START = 5_000_000_000


def steady(n: int = 3000, step: int = 1000) -> np.ndarray:
    return START + np.arange(n, dtype=np.int64) * step


def search(source: Source, wanted: NearGaze, block: int = 2**14) -> pa.Table:
    return search_rows(source, COLUMNS, mps.TIME_COLUMN, wanted, block=block)


def chosen(source: Source, wanted: NearGaze) -> pa.Table:
    """The independent way: read everything, then choose."""
    table = read_columns(source, COLUMNS)
    return table.take(wanted.rows(table[mps.TIME_COLUMN].to_numpy()))


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
    last_end=st.sampled_from(["", "\n", "\n\n\n"]),
    archived=st.booleans(),
    gaze=st.booleans(),
)
def test_the_same_rows_as_reading_all_of_them(
    folder, steps, wanted, exactly, block, end, last_end, archived, gaze
) -> None:
    times = START + np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    path = write_lines(folder / "t.csv", trajectory_lines(times), end=end, last_end=last_end)
    source = zipped(path) if archived else path
    asked = np.sort(
        np.append(START + np.array(wanted, dtype=np.int64), times[np.array(exactly, dtype=int) % len(times)])
    )
    near = NearGaze(asked) if gaze else NearTimes(asked)
    assert search(source, near, block).equals(chosen(path, near))


@pytest.mark.parametrize("archived", [False, True], ids=["plain", "zipped"])
def test_uneven_steps_gaps_and_lengths_in_a_longer_file(folder, archived) -> None:
    rng = np.random.default_rng(4)
    steps = np.where(rng.random(20_000) < 0.001, 400_000, rng.integers(1, 1180, 20_000))
    path = write_lines(folder / "long.csv", trajectory_lines(START + np.cumsum(steps)))
    near = NearGaze(START + np.arange(0, 12_000_000, 99_991))
    found = search(zipped(path) if archived else path, near)
    assert found.equals(chosen(path, near))
    assert len(found) < 2500


def test_rows_on_both_sides_by_hand(folder) -> None:
    path = write_lines(folder / "hand.csv", trajectory_lines(np.array([10, 20, 30, 40, 50, 60])))
    assert read_near(path, NearTimes(np.array([34, 41]))).time_us.tolist() == [30, 40, 50]
    assert read_near(path, NearTimes(np.array([20]))).time_us.tolist() == [10, 20]
    assert read_near(path, NearTimes(np.array([-7, 99]))).time_us.tolist() == [10, 60]
    assert mps.rows_around(np.array([10, 20, 30]), np.array([34, 20, -7])).tolist() == [0, 1, 2]


def test_the_grid_begins_with_the_trajectory_and_covers_its_end() -> None:
    wanted = mps.wanted_times_us(np.array([START - 5, START + 40_000, START + 10**9]), START, START + 100_000)
    assert (wanted - START).tolist() == [0, 33_333, 40_000, 66_667, 100_000]
    assert mps.wanted_times_us(np.array([], dtype=np.int64), START, START + 5).max() >= START + 5


def test_a_repeated_row_between_two_wanted_times_is_refused_with_its_line(folder) -> None:
    lines = trajectory_lines(steady())
    lines.insert(1501, lines[1500])  # line 1502 of the file repeats line 1501
    path = write_lines(folder / "repeated.csv", lines)
    with pytest.raises(InputFileError, match=r"line 1502: expected a time after 5001499000 us"):
        read_near(path, NearTimes(np.array([START + 1_498_500, START + 1_499_500])))


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [("tx_world_device", "nan", "finite numbers"), ("qw_world_device", "2.0", "length"), ("qx_world_device", "x", "")],
)
def test_a_damaged_row_that_is_looked_at_is_refused_with_its_line(folder, column, value, message) -> None:
    path = write_lines(folder / "damaged.csv", _with_cell(2000, column, value))
    with pytest.raises(InputFileError, match=rf"line 2001.*{message}"):
        read_near(path, NearTimes(np.array([START + 1_999_000])))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (lambda: _with_cell(2000, "tx_world_device", "nan"), "line 2001: expected a pose of finite numbers"),
        (lambda: _with_cell(2000, "tracking_timestamp_us", "5"), "line 2001: expected a time after 5001998000"),
        (lambda: _with_cell(2000, "qz_world_device", "0.5,0.5"), "line 2001"),
    ],
    ids=["no number", "time runs back", "too many cells"],
)
def test_damage_between_wanted_rows_is_noticed_by_the_thorough_check_only(folder, lines, message) -> None:
    path = write_lines(folder / "between.csv", lines())
    thin = read_near(path, NearTimes(np.array([START + 100_000, START + 2_900_000])))
    assert len(thin.time_us) == 4
    with pytest.raises(InputFileError, match=message):
        check_trajectory(path)


def _with_cell(row: int, column: str, value: str) -> list[str]:
    lines = trajectory_lines(steady())
    cells = lines[row].split(",")
    cells[lines[0].split(",").index(column)] = value
    lines[row] = ",".join(cells)
    return lines


def test_the_thorough_check_counts_gaps_worlds_and_poor_rows(folder) -> None:
    times = np.concatenate([steady(500), steady(500) + 700_000])
    worlds = [WORLD] * 900 + [mps.UNDEFINED_GRAPH] * 40 + [OTHER_WORLD] * 60
    lines = trajectory_lines(times, worlds=worlds, quality=np.where(np.arange(1000) < 10, 0.4, 1.0))
    path = write_lines(folder / "checked.csv", lines)
    found = check_trajectory(zipped(path))
    assert (found.rows, found.first_us, found.last_us) == (1000, START, START + 1_199_000)
    assert (found.gaps, found.longest_step_us, found.low_quality) == (1, 201_000, 10)
    assert found.worlds == {WORLD: 900, mps.UNDEFINED_GRAPH: 40, OTHER_WORLD: 60}


def test_rows_without_a_world_or_of_a_shorter_one_are_left_out(folder) -> None:
    worlds = [WORLD] * 2000 + [mps.UNDEFINED_GRAPH] * 400 + [OTHER_WORLD] * 600
    path = write_lines(folder / "worlds.csv", trajectory_lines(steady(), worlds=worlds))
    near = NearGaze(np.array([START + 500]))
    thin = read_near(path, near)
    assert thin.graph_uids == (WORLD, OTHER_WORLD)
    assert thin.time_us.max() < START + 2_000_000
    assert thin.left_out == len(chosen(path, near)) - len(thin.time_us) > 0


def test_text_that_cannot_be_searched_is_read_whole_instead(folder) -> None:
    lines = trajectory_lines(steady(50))
    quoted = [lines[0], *(line.replace(WORLD, f'"{WORLD}"', 1) for line in lines[1:])]
    path = write_lines(folder / "quoted.csv", quoted)
    with pytest.raises(NotSearchable):
        search(path, NearGaze(steady(50)))
    assert read_near(path, NearGaze(steady(50))).time_us.tolist() == steady(50).tolist()


def test_a_cut_last_line_is_refused(folder) -> None:
    columns_end = trajectory_lines(steady(100))
    cut = [line.rpartition(",")[0] for line in columns_end]  # the last column is one that is read
    path = write_lines(folder / "cut.csv", cut, last_end="")
    with pytest.raises(InputFileError, match="last line"):
        read_near(path, NearGaze(np.array([START])))
    path = write_lines(folder / "cut.csv", [*columns_end[:-1], columns_end[-1][:60]], last_end="")
    with pytest.raises(InputFileError, match="line 101"):
        read_near(path, NearGaze(np.array([START])))


def test_an_empty_file_and_one_without_rows_are_refused(folder) -> None:
    with pytest.raises(InputFileError, match="a column 'graph_uid'"):
        read_near(write_lines(folder / "empty.csv", [], end="", last_end=""), NearGaze(steady()))
    with pytest.raises(InputFileError, match="at least one pose"):
        read_near(write_lines(folder / "header.csv", trajectory_lines(steady(0))), NearGaze(steady()))
    with pytest.raises(InputFileError, match="no such file"):
        read_near(folder / "missing.csv", NearGaze(steady()))


@pytest.mark.parametrize("archived", [False, True], ids=["plain", "zipped"])
def test_memory_does_not_grow_with_the_file(folder, archived) -> None:
    path = write_lines(folder / "large.csv", trajectory_lines(steady(60_000)))
    size = path.stat().st_size
    source = zipped(path) if archived else path
    near = NearTimes(np.array([START + 5, START + 59_000_000]))
    search(source, near, 2**18)
    tracemalloc.start()
    search(source, near, 2**18)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**21 < size / 3
