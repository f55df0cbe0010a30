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
HANDS = f"P0001_a/{hot3d.UMETRACK_FILE}"
PEOPLE = "skeleton_aria_association.json"


def _object(change: Callable[[dict], object]) -> Damage:
    return edit_json("instances.json", change)


def _frame(joints: Any) -> Damage:
    return edit_json("Skeleton_T.json", lambda content: content["frames"][7].update(joints=joints))


def _hand(change: Callable[[dict], object]) -> Damage:
    return edit_json_line(HANDS, 6, lambda record: change(record["hand_poses"]["0"]))


def _segments(folder: Path) -> None:
    kind = np.dtype([("start", "f8"), ("end", "f8"), ("label", "S20")])
    rows = [(0, 100, b"null"), (float("nan"), 5, b"cup_red"), (101, 300, b"cup_red"), (301, 479, b"null")]
    replace_rows("segmentations", "segments", np.array(rows, dtype=kind))(folder)


def _other_key(folder: Path) -> None:
    with h5py.File(folder / "p1_1_object_data.hdf5", "r+") as file:
        file["bodies"].copy(f"body {CUP}", "a cup")


# By dataset: what is done, how the record of it begins, and what is found.
ODD: dict[str, list[tuple[Damage, str, str]]] = {
    "adt": [
        (_object(lambda content: content[FORK].pop("category")), f"instances.json, {FORK}", "field `category`"),
        (_object(lambda content: content.update({FORK: [1]})), f"instances.json, {FORK}", "`array` instead of"),
        (_object(lambda content: content[FORK].update(instance_id=FORK)), f"instances.json, {FORK}", "`str`"),
        (_object(lambda content: content.update(x=content[FORK])), "instances.json, x", f"{FORK} again"),
        (set_cell("3d_bounding_box.csv", 2, 3, ""), "3d_bounding_box.csv, line 2", "''"),
        (set_cell("3d_bounding_box.csv", 2, 3, "wide"), "3d_bounding_box.csv, line 2", "'wide'"),
        (set_cell("3d_bounding_box.csv", 2, 3, "1e300"), "3d_bounding_box.csv, line 2", "1e+300"),
        (_frame([[0.0] * 3] * 50), "Skeleton_T.json, frame 7", "150 numbers instead of 153"),
        (_frame([["a", "b", "c"]] * 51), "Skeleton_T.json, frame 7", "words"),
        (_frame(None), "Skeleton_T.json, frame 7", "1 numbers instead of 153"),
        (edit_json(PEOPLE, lambda content: content["SkeletonMetadata"].append({"x": 1})), PEOPLE, "missing required"),
    ],
    "hot3d": [
        (
            edit_json("assets/instance.json", lambda content: content.update({min(content): None})),
            "instance.json",
            "`null`",
        ),
        (edit_lines(HANDS, lambda lines: lines.insert(5, "{")), f"{hot3d.UMETRACK_FILE}, line 6", "truncated"),
        (_hand(lambda hand: hand["wrist_xform"].update(q_wxyz=[2.0, 0, 0, 0])), hot3d.UMETRACK_FILE, "of length 2.0"),
        (_hand(lambda hand: hand["wrist_xform"].update(t_xyz=[0, 4e8, 0])), hot3d.UMETRACK_FILE, "10000"),
        (
            _hand(lambda hand: hand.update(joint_angles=[0.0] * 19)),
            f"{hot3d.UMETRACK_FILE}, line 6, left hand",
            "19 angles",
        ),
        (set_cell("P0001_a/masks/mask_qa_pass.csv", 10, 2, "perhaps"), "mask_qa_pass.csv, line 10", "perhaps"),
    ],
    "mogaze": [
        (replace_text("scene.xml", 'name="plate_red"', ""), "scene.xml, body ", "and name ''"),
        (_other_key, "p1_1_object_data.hdf5, bodies/a cup", "'a cup'"),
        (
            replace_rows("object_data", f"bodies/body {PLATE}", np.zeros((N, 6))),
            "p1_1_object_data.hdf5, bodies/body",
            "shape",
        ),
        (_segments, "p1_1_segmentations.hdf5, segments[1]", "nan to 5"),
    ],
    "gimo": [
        (
            edit_lines("prbench_events.csv", lambda lines: lines.append(lines[1].rpartition(",")[0] + ",both")),
            "prbench_events.csv, line 3, column 'hand'",
            "'both'",
        ),
    ],
}
CASES = [(dataset, *case) for dataset, cases in ODD.items() for case in cases]
COPIES: dict[str, Callable[[Path], object]] = {
    "adt": write_adt,
    "hot3d": copy_of("hot3d-two-seconds", write_hot3d),
    "mogaze": write_scene,
    "gimo": lambda folder: gimo_sample.write_root(folder, gimo_sample.readings()),
}


def _read(dataset: str, root: Path) -> Recording:
    reader = reader_for(dataset)
    return reader.read(reader.find(root)[0])


@pytest.mark.parametrize(("dataset", "damage", "told", "found"), CASES)
def test_an_odd_entry_loses_itself_alone(dataset, damage, told, found, tmp_path) -> None:
    root = Path(COPIES[dataset](tmp_path) or tmp_path)  # type: ignore[arg-type]
    before = _read(dataset, root)
    damage(root)
    after = _read(dataset, root)
    (entry,) = after.unreadable
    assert str(entry).startswith(told)
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
