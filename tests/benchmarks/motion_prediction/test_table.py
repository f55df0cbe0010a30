from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from prbench.errors import TableError, UsageError
from prbench_benchmarks.motion_prediction.batch import Condition, ask
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity, ZeroVelocity
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction import windows
from tests.benchmarks.motion_prediction.windows import RULES


@pytest.fixture
def table(tmp_path) -> WindowsTable:
    return WindowsTable.open(windows.write(tmp_path / "windows"))


def given(batch) -> bytes:
    """Everything that a predictor is given, as bytes."""
    arrays = (batch.observed_joints, batch.gaze, batch.gaze_valid)
    parts = [b"" if array is None else array.tobytes() for array in arrays]
    words = (batch.condition, batch.fps, batch.n_future, batch.joint_names, batch.key)
    return b"|".join([*parts, repr(words).encode()])


def test_windows_are_slices_of_the_runs(table):
    run = windows.walking("a", 180)
    chosen = table.chosen(split="test")
    batch, truth = next(table.batches(Condition.POSE_GAZE, chosen, frame="room"))
    assert len(batch) == 7  # 180 - 75 = 105 is a multiple of the stride, and excluded itself
    np.testing.assert_array_equal(batch.observed_joints[1], run.joints[15:30].astype(np.float32))
    np.testing.assert_array_equal(truth.joints[1], run.joints[30:90].astype(np.float32))
    np.testing.assert_array_equal(batch.gaze[1], run.gaze[15:30].astype(np.float32))
    assert truth.recording_ids == ("a",) * 7


def test_in_the_frame_of_the_last_pose_the_pelvis_is_over_the_origin_and_faces_ahead(table):
    batch, truth = next(table.batches(Condition.POSE_HEAD, table.chosen()))
    np.testing.assert_allclose(batch.observed_joints[:, -1, 0, [0, 2]], 0.0, atol=1e-6)
    np.testing.assert_allclose(batch.observed_joints[:, -1, 2, 0], -batch.observed_joints[:, -1, 1, 0], atol=1e-5)
    room, recorded = next(table.batches(Condition.POSE_HEAD, table.chosen(), frame="room"))
    apart = np.linalg.norm(truth.joints[:, -1] - batch.observed_joints[:, -1], axis=-1)
    in_room = np.linalg.norm(recorded.joints[:, -1] - room.observed_joints[:, -1], axis=-1)
    np.testing.assert_allclose(apart, in_room, atol=1e-5)


@pytest.mark.filterwarnings("ignore:invalid value encountered in cast")  # of the digest of a table that holds NaN
@pytest.mark.parametrize("frame", ["room", "last-pose"])
@pytest.mark.parametrize("condition", list(Condition))
def test_futures_of_nan_leave_no_trace_in_what_a_predictor_is_given(tmp_path, condition, frame):
    run = windows.walking("a", 76)
    spoiled = {}
    for name in ("joints", "gaze", "head_direction"):
        values = getattr(run, name).copy()
        values[RULES.observed_frames :] = np.nan
        spoiled[name] = values
    looking = run.gaze_valid.copy()
    looking[RULES.observed_frames :] = False
    without = replace(run, **spoiled, gaze_valid=looking)
    tables = [WindowsTable.open(windows.write(tmp_path / name, each)) for name, each in (("a", run), ("b", without))]
    first, second = (next(each.batches(condition, each.chosen(), frame=frame)) for each in tables)
    assert np.isnan(second[1].joints).all()
    assert given(first[0]) == given(second[0])
    for predictor in (ZeroVelocity(), ConstantVelocity()):
        answers = [ask(predictor, batch, n_samples=2, seed=0).joints.tobytes() for batch, _ in (first, second)]
        assert answers[0] == answers[1]


def test_how_windows_come_in_batches_leaves_no_trace(table):
    whole = next(table.batches(Condition.POSE_GAZE, table.chosen()))[0]
    parts = [batch for batch, _ in table.batches(Condition.POSE_GAZE, table.chosen(), size=3)]
    assert given(whole.rows(0, 3)) == given(parts[0])
    assert sum(len(part) for part in parts) == len(whole)


def test_windows_with_little_gaze_or_an_invalid_body_are_counted_and_not_scored(tmp_path):
    run = windows.walking("a", 120)
    looking = run.gaze_valid.copy()
    looking[15:19] = False  # 11 of the 15 of the second window
    posed = run.joints_valid.copy()
    posed[0] = False  # in the first window, too
    table = WindowsTable.open(windows.write(tmp_path / "w", replace(run, gaze_valid=looking, joints_valid=posed)))
    assert len(table.chosen(with_excluded=True)) == 3
    assert table.windows["start"].take(table.chosen()).to_pylist() == [30]
    assert table.info.outcomes == {"invalid_body": 1, "window": 2}


def test_a_table_without_gaze_says_so(tmp_path):
    table = WindowsTable.open(windows.write(tmp_path / "w", windows.walking("a", 120, gaze=False)))
    assert not table.info.has_gaze
    assert len(table.chosen()) == 3
    with pytest.raises(UsageError, match="expected recorded gaze"):
        next(table.batches(Condition.POSE_GAZE, table.chosen()))


def test_a_choice_that_leaves_no_window_says_what_there_is(table):
    with pytest.raises(UsageError, match="test, train"):
        table.chosen(split="validation")


def test_a_recording_shorter_than_a_window_makes_no_table(tmp_path):
    with pytest.raises(TableError, match="0 windows in 0 runs"):
        windows.write_windows(tmp_path / "w", windows.info(), iter(()))
    assert not (tmp_path / "w").exists()


@pytest.mark.parametrize("name", ["streams", "windows"])
def test_a_table_that_was_edited_is_refused(tmp_path, name):
    folder = windows.write(tmp_path / "w")
    path = folder / f"{name}.parquet"
    pq.write_table(pq.read_table(path).slice(1), path)
    with pytest.raises(TableError, match=name):
        WindowsTable.open(folder)
