"""Streams that end before the recording does: the judge, the ends of files, and every dataset's layout."""

from __future__ import annotations

import json
import pickle
import re
import shutil
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from prbench.readers import RecordingFiles, cut_short, reader_for
from prbench.readers.extents import ONE_SYSTEM, SEVERAL_SENSORS, Extent, csv_extent, damage, json_extent, shortfalls
from prbench.readers.found import InputFile, input_file
from prbench.readers.hd_epic.files import extents as hd_epic_extents
from prbench.synthetic.write_tree import synthesize_tree
from tests.shared import made_once

WHOLE = Extent("glasses", "poses.csv", 100.0, 160.0)


def test_a_stream_may_end_as_early_as_its_sensor_does_and_no_earlier() -> None:
    for slack in (ONE_SYSTEM, SEVERAL_SENSORS):
        assert shortfalls([WHOLE, Extent("objects", "objects.csv", 100.0, 160.0 - slack, slack=slack)]) == ()
        (message,) = shortfalls([WHOLE, Extent("objects", "objects.csv", 100.0, 159.9 - slack, slack=slack)])
        assert f"objects (objects.csv) ends {slack + 0.1:.1f} s before the recording does" in message
        assert "may be cut off" in message


def test_a_stream_that_begins_late_is_told_unless_that_is_normal() -> None:
    late = Extent("body", "body.json", 103.0, 160.0)
    (message,) = shortfalls([WHOLE, late])
    assert "body (body.json) begins 3.0 s after the recording does" in message
    assert shortfalls([WHOLE, Extent("body", "body.json", 103.0, 160.0, may_start_late=True)]) == ()


def test_sensors_that_run_on_without_ground_truth_shorten_nobody() -> None:
    assert shortfalls([WHOLE, Extent("gaze", "gaze.csv", 80.0, 190.0, tells_span=False)]) == ()
    assert len(shortfalls([WHOLE, Extent("gaze", "gaze.csv", 80.0, 190.0)])) == 2, "the other one is short then"


def test_a_stream_without_samples_and_a_lonely_one() -> None:
    (message,) = shortfalls([WHOLE, Extent("gaze", "gaze.csv", None, None)])
    assert "gaze (gaze.csv) holds no sample with a time" in message
    assert shortfalls([WHOLE]) == ()
    assert shortfalls([]) == ()


def test_the_ends_of_long_files_are_found_without_reading_what_lies_between(tmp_path) -> None:
    rows = [f"{index},{'x' * 100},{-1 if index < 1000 else index * 1000}" for index in range(8000)]
    (tmp_path / "t.csv").write_text("\n".join(["id,what,time", *rows]) + "\n")
    extent = csv_extent("objects", input_file("", tmp_path / "t.csv"), "time", 1e-3)
    assert (extent.first, extent.last) == (1000.0, 7999.0), "-1 is no time"
    lines = "".join(f'{{"timestamp_ns": {10**9 * index}, "hand_poses": "{"x" * 100}"}}\n' for index in range(1, 8000))
    (tmp_path / "t.jsonl").write_text(lines)
    extent = json_extent("hands", input_file("", tmp_path / "t.jsonl"))
    assert (extent.first, extent.last) == pytest.approx((1.0, 7999.0))


@pytest.mark.parametrize("content", [b"", b"time\n", b"\xff\xfe\n1\n", b"other\n1\n", b"time\nnan\nx\n-1\n", b"time"])
def test_files_without_a_time_have_no_ends(tmp_path, content) -> None:
    (tmp_path / "t.csv").write_bytes(content)
    extent = csv_extent("gaze", input_file("", tmp_path / "t.csv"), "time", 1.0)
    assert (extent.first, extent.last) == (None, None)


def tree(layout: str) -> Path:
    """A synthetic recording in a layout, made once a run and not to be changed."""

    def make(root: Path) -> None:
        synthesize_tree(layout, root / layout, recordings=1, seed=4, n_events=2, estimates=layout == "adt")

    return made_once(f"whole-{layout}", make) / layout


def copy_of(layout: str, folder: Path) -> Path:
    """The recording, ready to be cut."""
    return Path(shutil.copytree(tree(layout), folder / layout))


def first_of(root: Path) -> RecordingFiles:
    dataset = root.name
    options = {"poses": "egoallo"} if dataset == "adt" else {}
    return reader_for(dataset, options).find(root)[0]


def keep_lines(path: Path, share: float) -> None:
    """Cut a text file between two lines, as a copy that stopped at a block's end by chance."""
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[: max(int(len(lines) * share), 2)]))


def keep_lines_of_member(archive: Path, name: str, share: float) -> None:
    """The same inside an archive that is whole itself."""
    with zipfile.ZipFile(archive) as whole:
        contents = {entry: whole.read(entry) for entry in whole.namelist()}
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as cut:
        for entry, content in contents.items():
            lines = content.splitlines(keepends=True)
            cut.writestr(entry, b"".join(lines[: int(len(lines) * share)]) if entry.endswith(name) else content)


def keep_rows(path: Path, name: str, share: float) -> None:
    """Cut the only array, or the first array of a group, of an HDF5 file."""
    with h5py.File(path, "r+") as file:
        entry = file[name]
        entry = entry[sorted(entry)[0]] if isinstance(entry, h5py.Group) else entry
        rows, place, attributes = np.asarray(entry), entry.name, dict(entry.attrs)
        del file[place]
        file.create_dataset(place, data=rows[: int(len(rows) * share)]).attrs.update(attributes)


@pytest.mark.parametrize("layout", ["adt", "hot3d", "hd-epic", "mogaze"])
def test_whole_recordings_of_every_layout_raise_no_alarm(layout) -> None:
    assert cut_short(first_of(tree(layout))) == ()


@pytest.mark.parametrize("dataset", ["adt", "hot3d", "hd-epic"])
def test_real_samples_raise_no_alarm(samples, dataset) -> None:
    for found in reader_for(dataset).find(samples / dataset):
        assert cut_short(found) == ()


SLAM_AND_GAZE = "HD-EPIC/SLAM-and-Gaze/*"


@pytest.mark.parametrize(
    ("layout", "pattern", "member", "stream"),
    [
        ("adt", "*/scene_objects.csv", "", "objects"),
        ("adt", "*/aria_trajectory.csv", "", "glasses"),
        ("adt", "*/eyegaze.csv", "", "gaze"),
        ("hot3d", "*/dynamic_objects.csv", "", "objects"),
        ("hot3d", "*/headset_trajectory.csv", "", "glasses' ground truth"),
        ("hot3d", "*/umetrack_hand_pose_trajectory.jsonl", "", "hands"),
        ("hot3d", "*/masks/mask_object_pose_available.csv", "", "mask"),
        ("hot3d", "*/mps/slam/closed_loop_trajectory.csv", "", "glasses"),
        ("hot3d", "*/mps/eye_gaze/*_eye_gaze.csv", "", "gaze"),
        ("hd-epic", "HD-EPIC/Videos/*/*_mp4_to_vrs_time_ns.csv", "", "video frames"),
        ("hd-epic", f"{SLAM_AND_GAZE}/SLAM/multi/*.zip", "closed_loop_trajectory.csv", "glasses"),
        ("hd-epic", f"{SLAM_AND_GAZE}/GAZE_HAND/*.zip", "general_eye_gaze.csv", "gaze"),
        ("hd-epic", f"{SLAM_AND_GAZE}/GAZE_HAND/*.zip", "wrist_and_palm_poses.csv", "hands"),
        ("mogaze", "*_gaze_data.hdf5", "gaze", "gaze"),
        ("mogaze", "*_human_data.hdf5", "data", "body"),
        ("mogaze", "*_object_data.hdf5", "bodies", "objects"),
        ("mogaze", "*_segmentations.hdf5", "segments", "labels"),
    ],
)
def test_a_file_that_stops_early_is_named_by_stream_and_file(tmp_path, layout, pattern, member, stream) -> None:
    copy = copy_of(layout, tmp_path)
    (path,) = copy.glob(pattern)
    if path.suffix == ".zip":
        keep_lines_of_member(path, member, 0.6)
    elif path.suffix == ".hdf5":
        keep_rows(path, member, 0.6)
    else:
        keep_lines(path, 0.6)
    (message,) = cut_short(first_of(copy))
    assert message.startswith(f"{stream} ({member if path.suffix == '.zip' else path.name}) ends ")


def test_of_a_large_archived_file_reading_tells_the_end(tmp_path, monkeypatch) -> None:
    copy = copy_of("hd-epic", tmp_path)
    (archive,) = copy.glob("HD-EPIC/SLAM-and-Gaze/*/SLAM/multi/*.zip")
    keep_lines_of_member(archive, "closed_loop_trajectory.csv", 0.6)
    shutil.rmtree(copy / "egoallo")
    monkeypatch.setattr("prbench.readers.extents.LARGEST_UNPACKED_FOR_ITS_END", 100_000)
    found = first_of(copy)
    assert {extent.stream for extent in hd_epic_extents(found, None)} == {"video frames", "gaze", "hands"}
    assert cut_short(found) == ()
    (message,) = cut_short(found, reader_for("hd-epic").read(found))
    assert message.startswith("glasses (closed_loop_trajectory.csv) ends ")


@pytest.mark.parametrize("layout", ["adt", "hot3d", "hd-epic"])
def test_bodies_of_egoallo_that_lack_their_last_windows_are_told(tmp_path, layout) -> None:
    copy = copy_of(layout, tmp_path)
    outputs = sorted(copy.rglob("egoallo_outputs/*.npz"), key=lambda path: int(path.stem.split("_")[-1].split("-")[0]))
    for path in outputs[1:]:
        path.unlink()
    (message,) = cut_short(first_of(copy))
    assert message.startswith(f"body by EgoAllo ({outputs[0].name}) ends ")


def test_a_suit_that_begins_late_is_normal_and_one_that_ends_early_is_not(tmp_path) -> None:
    copy = copy_of("adt", tmp_path)
    (path,) = copy.glob("*/Skeleton_*.json")
    frames = re.findall(rb'"timestamp_ns":\d+', path.read_bytes())
    path.write_bytes(b'{"frames":[{%s}]}' % b"},{".join(frames[len(frames) // 2 :]))
    assert cut_short(first_of(copy)) == ()
    path.write_bytes(b'{"frames":[{%s}]}' % b"},{".join(frames[: len(frames) // 2]))
    (message,) = cut_short(first_of(copy))
    assert message.startswith(f"body ({path.name}) ends ")


def test_frames_that_a_partial_copy_of_gimo_lacks_are_told(tmp_path) -> None:
    folder = tmp_path / "gimo" / "bedroom0122" / "2022-01-22"
    for place in ("smplx_local", "eye_pc"):
        (folder / place).mkdir(parents=True)
    (tmp_path / "gimo" / "dataset.csv").write_text(
        "sequence_path,start_frame,end_frame,scene,transformation,training\n"
        "2022-01-22,100,400,bedroom0122,transform_info_0.json,1\n"
    )
    for frame in range(100, 401):
        (folder / "smplx_local" / f"{frame}.pkl").touch()
        (folder / "eye_pc" / f"{frame}_center.ply").touch()
    (found,) = reader_for("gimo").find(tmp_path / "gimo")
    assert cut_short(found) == ()
    for frame in range(300, 401):
        (folder / "smplx_local" / f"{frame}.pkl").unlink()
    (found,) = reader_for("gimo").find(tmp_path / "gimo")
    (message,) = cut_short(found)
    assert message.startswith("body (299.pkl) ends 3.4 s before the recording does")


def write_hdf5(path) -> None:
    with h5py.File(path, "w") as file:
        file["data"] = np.arange(20000.0)


KINDS = {
    "t.csv": lambda path: path.write_text("time,x,y\n1,2,3\n2,3,4\n"),
    "t.json": lambda path: path.write_text(json.dumps({"a": [1, 2, {"b": 3}]})),
    "t.jsonl": lambda path: path.write_text('{"a": 1}\n{"a": 2222}\n'),
    "t.hdf5": write_hdf5,
    "t.npz": lambda path: np.savez(path, a=np.arange(50.0)),
    "t.pkl": lambda path: path.write_bytes(pickle.dumps({"a": list(range(100))})),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_whole_file_passes_and_a_cut_one_does_not(tmp_path, name) -> None:
    path = tmp_path / name
    KINDS[name](path)
    assert damage(input_file("any", path)) == ""
    content = path.read_bytes()
    path.write_bytes(content[: -max(4, len(content) // 5)])
    assert damage(input_file("any", path)) != ""
    path.write_bytes(b"")
    assert damage(input_file("any", path)) == "empty"


def test_an_archive_must_hold_the_file_that_is_wanted(tmp_path) -> None:
    path = tmp_path / "slam.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("0/slam/closed_loop_trajectory.csv", "a,b\n1,2\n")
    assert damage(InputFile("trajectory", path, 8, member="0/slam/closed_loop_trajectory.csv")) == ""
    assert "holds no" in damage(InputFile("trajectory", path, 8, member="1/slam/closed_loop_trajectory.csv"))


def test_a_file_that_went_away_is_told_and_does_not_end_the_inspection(tmp_path) -> None:
    assert "cannot be read" in damage(InputFile("gaze", tmp_path / "gone.csv", 8))
