"""Recordings become runs and windows, and tables of windows are built."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import InputFileError, PrbenchError, TableError, UsageError
from prbench.protocol.manifests import load_manifest
from prbench.readers.mogaze.format import Segment
from prbench.readers.mogaze.synthetic import write
from prbench.recording import BodyStream, GazeStream, PoseStream, PublishedTrack, Recording
from prbench.sequences.schema import digests_of_files
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import WindowsInfo, WindowsTable
from prbench_benchmarks.motion_prediction.windows import (
    build_windows,
    latest_gaze,
    plan_windows,
    runs_of_recording,
    runs_of_tracks,
    window_starts,
)
from tests.benchmarks.motion_prediction.windows import mogaze, swaying
from tests.fakes import STANDING
from tests.recording.mogaze_scene import N, still_life

RULES = load_prediction_protocol().windows


def recording(rate: float, seconds: float, *, gaze_rate: float = 10.0, lost: tuple[float, float] = (9e9, 9e9)):
    """A person who glides along +X at 1 m/s and whose gaze turns; the body is lost for a while."""
    times = np.arange(round(seconds * rate) + 1) / rate
    joints = STANDING + np.stack([times, 0 * times, 0 * times], axis=1)[:, None]
    looks = np.arange(round(seconds * gaze_rate) + 1) / gaze_rate
    direction = np.stack([np.sin(looks), 0 * looks, np.cos(looks)], axis=1)
    head = PoseStream(times, joints[:, 15], np.tile([1.0, 0, 0, 0], (len(times), 1)), np.ones(len(times), bool))
    return Recording(
        dataset="adt",
        recording_id="r",
        participant_id="p",
        pose_source="adt-optitrack",
        head_tilt_deg=0.0,
        span=(0.0, seconds),
        gaze=GazeStream(looks, np.zeros((len(looks), 3)), direction, np.ones(len(looks), bool)),
        camera=head,
        head=head,
        body=BodyStream(times, joints, (times < lost[0]) | (times > lost[1])),
        hands=(),
        objects=(),
    )


@pytest.mark.parametrize(("n", "windows"), [(0, 0), (75, 0), (76, 1), (90, 1), (91, 2), (300, 15)])
def test_the_number_of_windows_is_the_published_one(n, windows):
    assert len(window_starts(n, RULES)) == windows


@pytest.mark.parametrize("rate", [30.0, 120.0, 240.0, 29.97, 30.3])
def test_bodies_of_any_rate_come_to_thirty_frames_a_second(rate):
    (cut,) = runs_of_recording(recording(rate, 4.0), RULES, split="test")
    assert len(cut) == (120 if rate == 30.3 else 121)  # 4 s hold no whole number of 1/30.3 s
    np.testing.assert_allclose(np.diff(cut.joints[:, 0, 0]), 1 / 30, atol=0.5 / rate + 1e-9)
    assert {window.exclusion for window in cut.windows} == {""}


def test_a_multiple_of_the_rate_is_sampled_not_averaged():
    (cut,) = runs_of_recording(recording(120.0, 4.0), RULES, split="test")
    np.testing.assert_array_equal(cut.joints[7], STANDING + np.array([28 / 120, 0.0, 0.0]))


def test_a_long_gap_of_the_body_cuts_and_a_short_one_is_filled():
    runs = list(runs_of_recording(recording(30.0, 12.0, lost=(5.99, 6.21)), RULES, split="test"))
    assert [len(cut) for cut in runs] == [180, 174]
    (cut,) = runs_of_recording(recording(30.0, 12.0, lost=(5.99, 6.05)), RULES, split="test")
    assert len(cut) == 361
    np.testing.assert_allclose(np.diff(cut.joints[:, 0, 0]), 1 / 30, atol=1e-9)


@pytest.mark.parametrize(("rate", "lost"), [(30.0, (0.46, 0.47)), (30.3, (0.45, 0.48))])
def test_no_window_ends_its_observation_inside_a_gap(rate, lost):
    # Frame 14, at 0.467 s, is the last observed one of the first window.
    (cut,) = runs_of_recording(recording(rate, 5.0, lost=lost), RULES, split="test")
    assert [window.exclusion for window in cut.windows] == ["gap_at_border", "", "", "", "", ""]


def test_a_stretch_as_long_as_a_window_gives_none():
    assert list(runs_of_recording(recording(30.0, 74 / 30), RULES, split="test")) == []


def test_gaze_is_never_later_than_its_frame_and_at_most_0_12_s_old():
    times = np.array([0.0, 0.1, 0.3])
    directions = np.eye(3)
    frames = np.array([-0.01, 0.0, 0.05, 0.0999, 0.1, 0.2199, 0.2201, 0.31])
    held, valid = latest_gaze(times, directions, np.ones(3, bool), frames, oldest=0.12)
    assert held.argmax(axis=1).tolist() == [2, 0, 0, 0, 1, 1, 1, 2]
    assert valid.tolist() == [False, True, True, True, True, True, False, True]


def test_a_recording_without_body_gives_nothing():
    assert list(runs_of_recording(replace(recording(30.0, 4.0), body=None), RULES, split="test")) == []


def test_a_published_segment_stays_whole_and_says_which_windows_are_not_scored():
    source = recording(30.0, 4.0)
    assert source.body is not None
    n = len(source.body.times)
    valid = np.ones(n, bool)
    valid[100] = False
    track = PublishedTrack(
        name="pick_001",
        published_split="",
        times=source.body.times,
        joints=source.body.joints[:, :21],
        valid=valid,
        filled=np.zeros(n, bool),
        body=source.body.joints,
        gaze=np.tile([0.0, 0.0, 1.0], (n, 1)),
        gaze_measured=np.arange(n) % 5 == 0,
    )
    (cut,) = runs_of_tracks(source, (track,), RULES, split="train", published_split="test")
    assert (cut.run_id, cut.published_split, len(cut)) == ("r/pick_001", "test", n)
    assert [window.exclusion for window in cut.windows] == ["", "", "invalid_body", "invalid_body"]
    assert [window.n_gaze_valid for window in cut.windows] == [12] * 4  # of five frames the fifth is older than 0.12 s


def test_published_segments_have_native_joints_and_published_splits(tmp_path):
    report = build_windows(plan_windows("mogaze", mogaze()), tmp_path / "windows")
    table = WindowsTable.open(tmp_path / "windows")
    assert report.info.joint_set == "mogaze21"
    assert report.info.outcomes == {"window": 6}  # ceil((120 - 75) / 15) = 3 of each of the two
    assert table.runs["published_split"].to_pylist() == ["train", "test"]
    assert table.runs["participant_id"].to_pylist() == ["p1", "p7"]
    (batch, _), *_ = table.batches(Condition.POSE_GAZE, table.chosen(published_split="test"))
    assert batch.observed_joints.shape == (3, 15, 21, 3)


def test_every_dataset_has_the_22_joints(tmp_path):
    info = build_windows(plan_windows("mogaze", mogaze(), joints="smpl22"), tmp_path / "windows").info
    assert (info.joint_set, info.runs, info.outcomes) == ("smpl22", 2, {"window": 6})
    assert info.options["joints"] == "smpl22"
    native = build_windows(plan_windows("mogaze", mogaze()), tmp_path / "native")
    same = [WindowsTable.open(tmp_path / name).windows["window_id"].to_pylist() for name in ("windows", "native")]
    assert native.info.joint_set == "mogaze21"
    assert same[0] == same[1]


def test_the_description_says_what_was_asked_for_and_every_recording_is_told(tmp_path):
    told = []
    plan = plan_windows("mogaze", mogaze(), recordings="p*_1", limit=1)
    info = build_windows(plan, tmp_path / "w", progress=lambda *each: told.append(each)).info
    assert told == [(1, 1, "p1_1")]
    assert info.options == {"joints": "native", "recordings": "p*_1", "limit": "1"}
    assert (info.fps, info.observed_frames, info.future_frames, info.fewest_gaze_frames) == (30.0, 15, 60, 12)
    manifest = load_manifest("mogaze")
    assert (info.dataset, info.synthetic, info.licence, info.citation) == (
        "mogaze",
        False,
        manifest.licence,
        manifest.citation,
    )
    everything = build_windows(plan_windows("mogaze", mogaze()), tmp_path / "all").info
    assert everything.options["limit"] == "all"
    assert everything.input_digest != info.input_digest


def test_what_does_not_fit_in_memory_is_told(tmp_path):
    class Full:
        def map(self, function, items, *, if_full=None):
            for number, item in enumerate(items):
                yield function(item) if number else if_full(item, PrbenchError("8 GB wanted"))

    info = build_windows(plan_windows("mogaze", mogaze()), tmp_path / "w", engine=Full()).info
    assert (info.quarantine[0].recording_id, info.quarantine[0].message) == ("p1_1", "8 GB wanted")


class _Killed:
    """Ends after one recording, as a process that is killed does."""

    def map(self, function, items, *, if_full=None):
        yield function(next(iter(items)))
        raise KeyboardInterrupt


@pytest.mark.parametrize("failed", [False, True], ids=["read", "failed"])
def test_a_build_that_was_killed_goes_on_and_ends_in_equal_bytes(failed, tmp_path):
    root = shutil.copytree(mogaze(), tmp_path / "mogaze")
    build_windows(plan_windows("mogaze", root), tmp_path / "whole")
    gaze = root / "p1_1_gaze_data.hdf5"
    sound = gaze.read_bytes()
    if failed:
        gaze.write_bytes(b"\x89HDF")
    with pytest.raises(KeyboardInterrupt):
        build_windows(plan_windows("mogaze", root), tmp_path / "windows", engine=_Killed())
    assert not (tmp_path / "windows").exists()
    gaze.write_bytes(sound)  # what failed is tried again
    assert build_windows(plan_windows("mogaze", root), tmp_path / "windows").reused == (not failed)
    for name in ("streams.parquet", "windows.parquet", "windows.json"):
        assert (tmp_path / "windows" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert {path.name for path in tmp_path.iterdir()} <= {"mogaze", "whole", "windows"}


def test_a_damaged_recording_is_left_out_and_named(tmp_path):
    root = shutil.copytree(mogaze(), tmp_path / "mogaze")
    (root / "p7_1_gaze_data.hdf5").write_bytes(b"\x89HDF")
    info = build_windows(plan_windows("mogaze", root), tmp_path / "windows").info
    assert info.recordings == 1
    assert [(each.recording_id, each.status) for each in info.quarantine] == [("p7_1", "failed"), ("p7_2", "skipped")]
    with pytest.raises(InputFileError, match="p7_1_gaze_data"):
        build_windows(plan_windows("mogaze", root), tmp_path / "windows", on_error="fail")
    assert WindowsTable.open(tmp_path / "windows").info == info


def test_a_recording_whose_body_does_not_move_is_left_out_and_named_unless_it_is_vouched_for(tmp_path):
    root = shutil.copytree(mogaze(), tmp_path / "mogaze")
    frozen = replace(still_life(), recording_id="p1_1", segments=(Segment(0, N, "null"),))
    write(replace(frozen, gaze_points=swaying().gaze_points), root)
    info = build_windows(plan_windows("mogaze", root), tmp_path / "windows").info
    assert [(each.recording_id, each.status) for each in info.quarantine] == [("p1_1", "failed"), ("p7_2", "skipped")]
    assert info.quarantine[0].message.startswith("body: does not move at all for")
    told = build_windows(plan_windows("mogaze", root, shift=(("body", 0.0),)), tmp_path / "vouched")
    assert told.info.recordings == 2
    assert any(finding.startswith("body: does not move at all") for finding in told.records[0].findings)
    # Nothing of a window is made of objects: a cup that moves by itself is told, and refuses nothing.
    assert [finding.split(":")[0] for finding in told.records[1].findings] == ["objects"]
    assert told.info.options["shift.body"] == "0"


def test_published_segments_are_not_moved():
    with pytest.raises(UsageError, match="nothing moves or scales"):
        plan_windows("mogaze", mogaze(), shift=(("gaze", -0.5),))


def test_native_joints_of_a_dataset_without_them_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("prbench_benchmarks.motion_prediction.windows.native_sources", lambda *_: [_Source()])
    with pytest.raises(InputFileError, match="published"):
        build_windows(plan_windows("adt", tmp_path, joints="native"), tmp_path / "windows")


class _Source:
    dataset = "adt"


def test_segments_shorter_than_a_window_make_no_table(tmp_path):
    write(swaying(), tmp_path / "mogaze")
    with pytest.raises(TableError, match="0 windows"):
        build_windows(plan_windows("mogaze", tmp_path / "mogaze"), tmp_path / "windows")
    assert not (tmp_path / "windows").exists()


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("small") / "windows"
    build_windows(plan_windows("mogaze", mogaze()), folder)
    return folder


@pytest.mark.parametrize(
    ("name", "found", "said"),
    [
        ("future_frames", -40, "Expected `int` >= 1 - at `$.future_frames`"),
        ("future_frames", 60_000, "Expected `int` <= 5000 - at `$.future_frames`"),
        ("future_frames", 61, "windows.json, future_frames: expected 60, as the table has it, found 61"),
        ("observed_frames", 14, "windows.json, observed_frames: expected 15, as the table has it, found 14"),
        ("fewest_gaze_frames", 0, "windows.json, fewest_gaze_frames: expected 12"),
        ("fps", 0, "Expected `float` > 0.0 - at `$.fps`"),
        ("frames", 1, "windows.json, frames: expected "),
        ("runs", -1, "Expected `int` >= 0 - at `$.runs`"),
        ("participants", 99, "windows.json, participants: expected "),
        ("content_digest", "0" * 64, "the values are not the ones that windows.json describes (content digest"),
        ("identity_digest", "0" * 64, "the values are not the ones that windows.json describes (identity digest"),
    ],
)
def test_numbers_of_the_description_are_held_against_the_table(name, found, said, small, tmp_path):
    folder = shutil.copytree(small, tmp_path / "windows")
    told = json.loads((folder / "windows.json").read_text())
    (folder / "windows.json").write_text(json.dumps(told | {name: found}))
    with pytest.raises(TableError, match=re.escape(said)):
        WindowsTable.open(folder)


@pytest.mark.parametrize(
    ("column", "found", "said"),
    [
        ("row", 99, "column 'row': expected 0 to "),
        ("start", -1, "column 'start': expected 0 to "),
        ("start", 10**6, "column 'start': expected 0 to "),
        ("n_scored", 61, "column 'n_scored': expected 1 to 60, found 61"),
        ("n_gaze_valid", 16, "column 'n_gaze_valid': expected 0 to 15, found 16"),
    ],
)
def test_windows_lie_in_their_runs(column, found, said, small, tmp_path):
    folder = shutil.copytree(small, tmp_path / "windows")
    rows = pq.read_table(folder / "windows.parquet")
    values = rows[column].to_pylist()
    values[2] = found
    place = rows.schema.get_field_index(column)
    changed = rows.set_column(place, rows.schema.field(place), pa.array(values, pa.int32()))
    pq.write_table(changed, folder / "windows.parquet")
    info = WindowsInfo.read(folder)
    msgspec.structs.replace(info, file_digests=digests_of_files(folder, ["streams", "windows"])).write(folder)
    with pytest.raises(TableError, match=f"windows, row 2, {said}"):
        WindowsTable.open(folder)
