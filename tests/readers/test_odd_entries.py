"""One odd entry of an annotation file loses itself at most: it is named, and what stands beside it is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from prbench.readers import reader_for
from prbench.readers.adt.files import read_readings
from prbench.readers.hot3d import format as hot3d
from prbench.recording import Recording
from tests.laws.readers_cases import copy_of, replace_rows, write_adt, write_hot3d
from tests.readers import gimo_sample
from tests.readers.damages import Damage, edit_json, edit_json_line, edit_lines, replace_text, set_cell
from tests.recording.mogaze_scene import CUP, PLATE, N, write_scene

FORK = "3758151980953788"


def _frame(joints: Any) -> Damage:
    return edit_json("Skeleton_T.json", lambda content: content["frames"][7].update(joints=joints))


def _instance(change: Callable[[dict], object]) -> Damage:
    return edit_json("instances.json", lambda content: change(content))


def _hand(change: Callable[[dict], object]) -> Damage:
    return edit_json_line(f"P0001_a/{hot3d.UMETRACK_FILE}", 6, lambda r: change(r["hand_poses"]["0"]))


def _segments(rows: list[tuple[float, float, bytes]]) -> Damage:
    kind = np.dtype([("start", "f8"), ("end", "f8"), ("label", "S20")])
    return replace_rows("segmentations", "segments", np.array(rows, dtype=kind))


def _other_key(folder: Path) -> None:
    with h5py.File(folder / "p1_1_object_data.hdf5", "r+") as file:
        file["bodies"].copy(f"body {CUP}", "a cup")


# Dataset, damage, file, beginning of the key, and part of what is said.
ODD: dict[str, tuple[str, Damage, str, str, str]] = {
    "an object without category": (
        "adt", _instance(lambda content: content[FORK].pop("category")), "instances.json", FORK, "field `category`"
    ),
    "a list for an object": (
        "adt", _instance(lambda content: content.update({FORK: [1]})), "instances.json", FORK, "`array` instead of"
    ),
    "an id as text": (
        "adt", _instance(lambda content: content[FORK].update(instance_id=FORK)), "instances.json", FORK, "`str`"
    ),
    "an id twice": (
        "adt", _instance(lambda content: content.update(x=content[FORK])), "instances.json", "x", f"{FORK} again"
    ),
    "a box without corner": ("adt", set_cell("3d_bounding_box.csv", 2, 3, ""), "3d_bounding_box.csv", "line 2", "''"),
    "a box of words": ("adt", set_cell("3d_bounding_box.csv", 2, 3, "wide"), "3d_bounding_box.csv", "line 2", "'wide'"),
    "a huge box": ("adt", set_cell("3d_bounding_box.csv", 2, 4, "1e300"), "3d_bounding_box.csv", "line 2", "1e+300"),
    "50 joints": ("adt", _frame([[0.0] * 3] * 50), "Skeleton_T.json", "frame 7", "150 numbers instead of 153"),
    "joints of words": ("adt", _frame([["a", "b", "c"]] * 51), "Skeleton_T.json", "frame 7", "words"),
    "a frame of null": ("adt", _frame(None), "Skeleton_T.json", "frame 7", "1 numbers instead of 153"),
    "a person without name": (
        "adt",
        edit_json("skeleton_aria_association.json", lambda content: content["SkeletonMetadata"].append({"x": 1})),
        "skeleton_aria_association.json",
        "SkeletonMetadata[",
        "missing required field",
    ),
    "a name that is none": (
        "hot3d",
        edit_json("assets/instance.json", lambda content: content.update({min(content): None})),
        "instance.json",
        "",
        "`null` instead of",
    ),
    "a line that is no JSON": (
        "hot3d",
        edit_lines(f"P0001_a/{hot3d.UMETRACK_FILE}", lambda lines: lines.insert(5, "{")),
        hot3d.UMETRACK_FILE,
        "line 6",
        "truncated",
    ),
    "a hand's long quaternion": (
        "hot3d",
        _hand(lambda hand: hand["wrist_xform"].update(q_wxyz=[2.0, 0, 0, 0])),
        hot3d.UMETRACK_FILE,
        "line 6, left hand",
        "quaternion of length 2.0",
    ),
    "a hand of 19 angles": (
        "hot3d", _hand(lambda hand: hand.update(joint_angles=[0.0] * 19)), hot3d.UMETRACK_FILE, "line 6, left", "19"
    ),
    "a hand beyond the moon": (
        "hot3d",
        _hand(lambda hand: hand["wrist_xform"].update(t_xyz=[0, 4e8, 0])),
        hot3d.UMETRACK_FILE,
        "line 6, left hand",
        "10000",
    ),
    "an unknown hand": (
        "hot3d",
        edit_json_line(f"P0001_a/{hot3d.UMETRACK_FILE}", 6, lambda record: record["hand_poses"].update({"7": "?"})),
        "",
        "",
        "",
    ),
    "a word in a mask": (
        "hot3d", set_cell("P0001_a/masks/mask_qa_pass.csv", 10, 2, "perhaps"), "mask_qa_pass.csv", "line 10", "perhaps"
    ),
    "a body without name": (
        "mogaze", replace_text("scene.xml", 'name="plate_red"', ""), "scene.xml", "body ", "and name ''"
    ),
    "a body's key without id": ("mogaze", _other_key, "p1_1_object_data.hdf5", "bodies/a cup", "'a cup'"),
    "6 columns of a body": (
        "mogaze",
        replace_rows("object_data", f"bodies/body {PLATE}", np.zeros((N, 6))),
        "p1_1_object_data.hdf5",
        f"bodies/body {PLATE}",
        "shape",
    ),
    "a segment of no frame": (
        "mogaze",
        _segments([(0, 100, b"null"), (float("nan"), 5, b"cup_red"), (101, 300, b"cup_red"), (301, 479, b"null")]),
        "p1_1_segmentations.hdf5",
        "segments[1]",
        "nan to 5",
    ),
    "an event's hand": (
        "gimo",
        edit_lines("prbench_events.csv", lambda lines: lines.append(lines[1].rpartition(",")[0] + ",both")),
        "prbench_events.csv",
        "line 3, column 'hand'",
        "'both'",
    ),
}  # fmt: skip
COPIES: dict[str, Callable[[Path], object]] = {
    "adt": write_adt,
    "hot3d": copy_of("hot3d-two-seconds", write_hot3d),
    "mogaze": write_scene,
    "gimo": lambda folder: gimo_sample.write_root(folder, gimo_sample.readings()),
}


def _read(dataset: str, root: Path) -> Recording:
    reader = reader_for(dataset)
    return reader.read(reader.find(root)[0])


@pytest.mark.parametrize("name", ODD)
def test_an_odd_entry_loses_itself_alone(name, tmp_path) -> None:
    dataset, damage, file, key, found = ODD[name]
    root = COPIES[dataset](tmp_path) or tmp_path
    before = _read(dataset, root)
    damage(root)
    after = _read(dataset, root)
    assert [entry.file for entry in after.unreadable] == ([file] if file else [])
    for entry in after.unreadable:
        assert entry.key.startswith(key)
        assert found in entry.found
    assert len(before.objects) - len(after.objects) <= 1
    assert len(after.annotated_events) >= len(before.annotated_events) - 2
    assert (after.body is None, len(after.hands)) == (before.body is None, len(before.hands))
    assert before.unreadable == ()


def test_many_odd_frames_of_a_stream_are_told_together(tmp_path) -> None:
    write_adt(tmp_path)
    root = tmp_path / "still_life"
    edit_json("Skeleton_T.json", lambda content: [frame.pop("joints") for frame in content["frames"][3:13]])(root)
    (found,) = reader_for("adt").find(root)
    readings = read_readings(found)
    assert [entry.key for entry in readings.unreadable] == ["frame 3 and 9 more"]
    assert len(readings.skeletons[0].time_ns) == 121 - 10


def test_a_line_that_is_no_segment_is_skipped_and_the_others_are_found(tmp_path) -> None:
    gimo_sample.write_root(tmp_path, gimo_sample.readings())
    edit_lines("dataset.csv", lambda lines: lines.append(lines[1].replace(",100,", ",ten,")))(tmp_path)
    edit_lines("prbench_events.csv", lambda lines: lines.append("room1,2022-01-23-080759,100,999,139,pick,"))(tmp_path)
    reasons = {found.recording_id: found.skip_reason for found in reader_for("gimo").find(tmp_path)}
    assert list(reasons.values()).count(None) == 1
    assert "found room1, 2022-01-23-080759, 100, 999" in str(reasons["prbench_events.csv-line-3"])
    assert "'ten'" in str(reasons["dataset.csv-line-3"])
