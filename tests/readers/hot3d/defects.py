"""Defects of real copies of HOT3D (docs/specification/hot3d.md#pitfalls-and-bad-input)."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec

from prbench.readers.aria_mps.format import GAZE_FOLDER, SLAM_FOLDER, TRAJECTORY_FILE
from prbench.readers.egoallo.format import OUTPUT_FOLDER
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.synthetic import LIBRARY
from tests.readers.defects import Damage, Defect, change_cells, change_json, missing

_TRAJECTORY = f"{hot3d.MPS_FOLDER}/{SLAM_FOLDER}/{TRAJECTORY_FILE}"
_GAZE_FILES = f"{hot3d.MPS_FOLDER}/{GAZE_FOLDER}/*_eye_gaze.csv"

Rows = list[list[str]]


def _without(pattern: str) -> Damage:
    """Return a damage that removes all files of a pattern, in which ``{}`` stands for the recording."""

    def apply(root: Path, recording: str) -> None:
        for path in list(root.glob(pattern.format(recording))):
            path.unlink()

    return apply


def _cut_a_model(root: Path, recording: str) -> None:
    uid = (root / recording / hot3d.OBJECTS_FILE).read_text(encoding="utf-8").splitlines()[1].split(",")[0]
    path = root / LIBRARY / f"{uid}.glb"
    path.write_bytes(path.read_bytes()[:60])


def _metadata(change: Callable[[dict], object]) -> Damage:
    return lambda root, recording: change_json(root / recording / hot3d.METADATA_FILE, change)


def _with_rows(name: str, change: Callable[[Rows], Rows]) -> Damage:
    """Return a damage that changes the lines of a table below its header."""
    return lambda root, recording: change_cells(root / recording / name, change)


def _shift_a_third(rows: Rows) -> Rows:
    """Let the clock jump by 3 ms in the middle: neither an offset nor a drift fits all rows."""
    later = 2 * len(rows) // 3
    return [[row[0], str(int(row[1]) + 3_000_000), *row[2:]] if n > later else row for n, row in enumerate(rows)]


def _hand_lines(change: Callable[[list[bytes]], list[bytes]]) -> Damage:
    """Return a damage that changes the lines of hand poses."""

    def apply(root: Path, recording: str) -> None:
        path = root / recording / hot3d.UMETRACK_FILE
        path.write_bytes(b"\n".join(change(path.read_bytes().splitlines())) + b"\n")

    return apply


def _without_hands(line: bytes) -> bytes:
    return json.dumps({"timestamp_ns": msgspec.json.decode(line)["timestamp_ns"], "hand_poses": {}}).encode()


def _lose_an_object(rows: Rows) -> Rows:
    """Remove a quarter of one object's instants, RGB and SLAM rows alike."""
    uid = rows[0][0]
    seen = 0
    kept = []
    for row in rows:
        seen += row[0] == uid
        if row[0] != uid or (seen - 1) % 8 > 1:
            kept.append(row)
    return kept


def _fail_the_start(root: Path, recording: str) -> None:
    """Mark the first second as wrong, as newer releases do."""
    header, *lines = (
        (root / recording / hot3d.MASK_FOLDER / "mask_hand_pose_available.csv").read_text(encoding="utf-8").splitlines()
    )
    first = int(lines[0].split(",")[0])
    flags = [(*line.split(",")[:2], str(int(line.split(",")[0]) - first > 1e9)) for line in lines]
    path = root / recording / hot3d.MASK_FOLDER / "mask_qa_pass.csv"
    path.write_text("\n".join([header, *(",".join(flag) for flag in flags)]) + "\n", encoding="utf-8")


def _lose_gaze_angles(root: Path, recording: str) -> None:
    """Empty the angles of every row, as while eyes are closed."""
    for path in (root / recording).glob(_GAZE_FILES):
        change_cells(path, lambda rows: [[row[0], "", "", "", *row[4:]] for row in rows])


_WITHHELD = _metadata(
    lambda content: content.update(gt_available_status=dict.fromkeys(content["gt_available_status"], False))
)
_QUEST = _metadata(lambda content: content.update(headset="Quest3"))
_BACKWARDS = _with_rows(hot3d.OBJECTS_FILE, lambda rows: rows[::-1])
_ELSEWHERE = _with_rows(
    hot3d.HEADSET_FILE, lambda rows: [[*row[:2], f"{float(row[2]) + 3.0}", *row[3:]] for row in rows]
)
_JUMP = _with_rows(hot3d.HEADSET_FILE, _shift_a_third)
_GAP = _with_rows(_TRAJECTORY, lambda rows: [*rows[: len(rows) // 2], *rows[len(rows) // 2 + 1000 :]])  # a second
_LOST_OBJECT = _with_rows(hot3d.OBJECTS_FILE, _lose_an_object)
_BROKEN_LINES = _hand_lines(
    lambda lines: [line[: len(line) // 2] if 100 <= number < 130 else line for number, line in enumerate(lines)]
)
_NO_HANDS = _hand_lines(lambda lines: [_without_hands(line) for line in lines])
_NO_BODIES = _without(f"{{}}/{OUTPUT_FOLDER}/*")

DEFECTS: tuple[Defect, ...] = (
    Defect("missing-objects", "dynamic_objects.csv is not there", missing(hot3d.OBJECTS_FILE), "failed", "this file"),
    Defect("missing-slam", "no trajectory of the services", missing(_TRAJECTORY), "failed", TRAJECTORY_FILE),
    Defect("missing-profile", "no hand model: wrists only", missing(hot3d.PROFILE_FILE), "read", "wrists only"),
    Defect("missing-bodies", "no outputs of EgoAllo", _NO_BODIES, "read", "no EgoAllo outputs"),
    Defect("missing-models", "no object models", _without(f"{LIBRARY}/*.glb"), "read", "objects without a model"),
    Defect("cut-model", "an object model ends early", _cut_a_model, "failed", "binary glTF"),
    Defect("withheld", "a test participant", _WITHHELD, "skipped", "withholds the ground truth"),
    Defect("quest", "recorded with Quest 3", _QUEST, "skipped", "no gaze"),
    Defect("backwards", "rows from last to first", _BACKWARDS, "failed", "backwards"),
    Defect("other-world", "another world", _ELSEWHERE, "failed", "not one world"),
    Defect("clock-jump", "the clock jumps", _JUMP, "failed", "no drift"),
    Defect("slam-gap", "a second without SLAM", _GAP, "read", "clocks aligned"),
    Defect("nan-gaze", "no gaze row holds an angle", _lose_gaze_angles, "read", "nothing can be primed"),
    Defect("lost-object", "rows missing", _LOST_OBJECT, "read", "of its poses"),
    Defect("failed-start", "the first second is wrong", _fail_the_start, "read", "fail the quality check"),
    Defect(
        "broken-lines", "thirty damaged lines of hand poses", _BROKEN_LINES, "read", "cannot be read and are left out"
    ),
    Defect("lost-hands", "hands never tracked", _NO_HANDS, "read", "never tracked"),
)
