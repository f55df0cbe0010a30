from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from prbench.errors import InputFileError, StorageError, TableError
from prbench.readers.mogaze.format import Segment
from prbench.readers.mogaze.synthetic import write
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.table import WindowsTable
from prbench_benchmarks.motion_prediction.windows import build_windows, plan_windows
from tests.recording.mogaze_scene import CUP, GOGGLES, PLATE, TABLE, N, still_life


@pytest.fixture
def root(tmp_path):
    """Three recordings, each one segment of 120 frames at 30 frames a second."""
    for name in ("p1_1", "p7_1", "p7_2"):
        readings = replace(still_life(), recording_id=name, participant_id=name[:2], segments=(Segment(0, N, "null"),))
        write(readings, tmp_path / "mogaze")
    names = {CUP: "cup_red", PLATE: "plate_red", GOGGLES: "goggles", TABLE: "table"}
    bodies = "".join(f'<body id="{key}" name="{name}"/>' for key, name in names.items())
    (tmp_path / "mogaze" / "scene.xml").write_text(f"<scene>{bodies}</scene>")
    return tmp_path / "mogaze"


def test_published_segments_have_native_joints_and_published_splits(root, tmp_path):
    report = build_windows(plan_windows("mogaze", root), tmp_path / "windows")
    table = WindowsTable.open(tmp_path / "windows")
    assert report.info.joint_set == "mogaze21"
    assert report.info.outcomes == {"window": 6}  # ceil((120 - 75) / 15) = 3 of each of the two
    assert table.runs["published_split"].to_pylist() == ["train", "test"]
    assert table.runs["participant_id"].to_pylist() == ["p1", "p7"]
    (batch, _), *_ = table.batches(Condition.POSE_GAZE, table.chosen(published_split="test"))
    assert batch.observed_joints.shape == (3, 15, 21, 3)


def test_every_dataset_has_the_22_joints(root, tmp_path):
    info = build_windows(plan_windows("mogaze", root, joints="smpl22"), tmp_path / "windows").info
    assert (info.joint_set, info.runs, info.outcomes) == ("smpl22", 2, {"window": 6})
    assert info.options["joints"] == "smpl22"
    native = build_windows(plan_windows("mogaze", root), tmp_path / "native")
    same = [WindowsTable.open(tmp_path / name).windows["window_id"].to_pylist() for name in ("windows", "native")]
    assert native.info.joint_set == "mogaze21"
    assert same[0] == same[1]


class _Elsewhere:
    """Sends work and results through pickle, as processes do."""

    def map(self, function, items, *, if_full=None):
        for item in items:
            there = pickle.loads(pickle.dumps((function, item)))
            yield pickle.loads(pickle.dumps(there[0](there[1])))


def test_other_processes_change_nothing(root, tmp_path):
    build_windows(plan_windows("mogaze", root), tmp_path / "one")
    build_windows(plan_windows("mogaze", root), tmp_path / "two", engine=_Elsewhere())
    for name in ("streams.parquet", "windows.parquet", "windows.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


class _Killed:
    """Ends after one recording, as a process that is killed does."""

    def map(self, function, items, *, if_full=None):
        yield function(next(iter(items)))
        raise KeyboardInterrupt


def test_a_build_that_was_killed_goes_on_and_ends_in_equal_bytes(root, tmp_path):
    build_windows(plan_windows("mogaze", root), tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        build_windows(plan_windows("mogaze", root), tmp_path / "windows", engine=_Killed())
    assert not (tmp_path / "windows").exists()
    report = build_windows(plan_windows("mogaze", root), tmp_path / "windows")
    assert report.reused == 1
    for name in ("streams.parquet", "windows.parquet", "windows.json"):
        assert (tmp_path / "windows" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert {path.name for path in tmp_path.iterdir()} <= {"mogaze", "whole", "windows"}


def test_a_damaged_recording_is_left_out_and_named(root, tmp_path):
    (root / "p7_1_gaze_data.hdf5").write_bytes(b"\x89HDF")
    info = build_windows(plan_windows("mogaze", root), tmp_path / "windows").info
    assert info.recordings == 1
    assert [(each.recording_id, each.status) for each in info.quarantine] == [
        ("p7_1", "failed"),
        ("p7_2", "skipped"),
    ]
    with pytest.raises(InputFileError, match="p7_1_gaze_data"):
        build_windows(plan_windows("mogaze", root), tmp_path / "windows", on_error="fail")
    assert WindowsTable.open(tmp_path / "windows").info == info


def test_native_joints_of_a_dataset_without_them_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("prbench_benchmarks.motion_prediction.windows.native_sources", lambda *_: [_Source()])
    with pytest.raises(InputFileError, match="published"):
        build_windows(plan_windows("adt", tmp_path, joints="native"), tmp_path / "windows")


class _Source:
    dataset = "adt"


def test_segments_shorter_than_a_window_make_no_table(tmp_path):
    write(still_life(), tmp_path / "mogaze")
    with pytest.raises(TableError, match="0 windows"):
        build_windows(plan_windows("mogaze", tmp_path / "mogaze"), tmp_path / "windows")
    assert not (tmp_path / "windows").exists()


def test_a_folder_of_something_else_is_not_replaced(root, tmp_path):
    (tmp_path / "thesis.txt").write_text("dear")
    with pytest.raises(StorageError, match="no table of windows"):
        build_windows(plan_windows("mogaze", root), tmp_path)
