"""Defects of real copies of Aria Digital Twin.

Sources: docs/specification/adt.md#frame-units-clock, docs/specification/adt.md#files, docs/specification/adt.md#joints
and docs/specification/adt.md#pitfalls-and-bad-input.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from prbench.files.storage import write_json
from prbench.readers.adt import format as adt
from prbench.readers.aria_mps import format as mps
from prbench.synthetic.layouts import Damage, Defect, Row, change_json, changed_rows, cut_in_half, missing, removed


def _truncated(name: str) -> Damage:
    """Cut a file in the middle of a number, as a copy that stopped."""

    def cut(root: Path, recording: str) -> None:
        path = root / recording / name
        content = path.read_bytes()
        middle = content.rindex(b".", 0, len(content) // 2)
        path.write_bytes(content[: middle + 2])

    return cut


def _rows(name: str, change: Callable[[list[Row]], Iterable[Row]]) -> Damage:
    """Change the rows of a CSV file."""

    def rewrite(root: Path, recording: str) -> None:
        path = root / recording / name
        path.write_text(changed_rows(path.read_text(), change))

    return rewrite


def _content(name: str, change: Callable[[Any], None]) -> Damage:
    """Change the content of a JSON file in place."""
    return lambda root, recording: change_json(root / recording / name, change)


def _middle_third(rows: list[Row]) -> slice:
    return slice(len(rows) // 3, 2 * len(rows) // 3)


def _without_middle(rows: list[Row]) -> list[Row]:
    middle = _middle_third(rows)
    return rows[: middle.start] + rows[middle.stop :]


def _with_middle(values: dict[str, str]) -> Callable[[list[Row]], list[Row]]:
    """Overwrite columns in the middle third."""

    def change(rows: list[Row]) -> list[Row]:
        middle = range(len(rows))[_middle_third(rows)]
        return [row | values if number in middle else row for number, row in enumerate(rows)]

    return change


def _scaled(columns: tuple[str, ...], factor: float) -> Callable[[list[Row]], list[Row]]:
    def change(rows: list[Row]) -> list[Row]:
        return [row | {name: repr(float(row[name]) * factor) for name in columns if row[name]} for row in rows]

    return change


def _integers_scaled(column: str, factor: int) -> Callable[[list[Row]], list[Row]]:
    return lambda rows: [row | {column: str(int(row[column]) * factor)} for row in rows]


def _one_twice(rows: list[Row]) -> list[Row]:
    return [*rows[: len(rows) // 2], *rows[len(rows) // 2 - 1 :]]


def _two_swapped(rows: list[Row]) -> list[Row]:
    middle = len(rows) // 2
    return [*rows[:middle], rows[middle + 1], rows[middle], *rows[middle + 2 :]]


def _one_object_lost(rows: list[Row]) -> list[Row]:
    """Remove all poses of one tracked object."""
    lost = min(row[adt.OBJECT_ID] for row in rows if row[adt.OBJECT_TIME] != str(adt.STATIC_TIME))
    return [row for row in rows if row[adt.OBJECT_ID] != lost]


def _objects_untracked(rows: list[Row]) -> list[Row]:
    """Remove all poses of objects in the middle third of the recording."""
    times = sorted({int(row[adt.OBJECT_TIME]) for row in rows} - {adt.STATIC_TIME})
    first = times[len(times) // 3]
    last = times[2 * len(times) // 3]
    return [row for row in rows if not first <= int(row[adt.OBJECT_TIME]) < last]


def _skeleton(root: Path, recording: str) -> Path:
    """Return the wearer's skeleton file."""
    folder = root / recording
    serial = json.loads((folder / adt.METADATA_FILE).read_text())["serial"]
    people = json.loads((folder / adt.ASSOCIATION_FILE).read_text())["SkeletonMetadata"]
    name = next(person["SkeletonName"] for person in people if person["AssociatedDeviceSerial"] == serial)
    return folder / f"{name}.json"


def _no_skeleton(root: Path, recording: str) -> None:
    """Remove the suit, which nobody wore in more than half of the dataset."""
    _skeleton(root, recording).unlink()
    write_json(root / recording / adt.ASSOCIATION_FILE, {"SkeletonMetadata": []})


def _frames(change: Callable[[list[Any]], None]) -> Damage:
    def rewrite(root: Path, recording: str) -> None:
        path = _skeleton(root, recording)
        content = json.loads(path.read_text())
        change(content["frames"])
        path.write_text(json.dumps(content))

    return rewrite


def _lost_markers(frames: list[Any]) -> None:
    """Move all joints to the origin for a second, as a suit out of sight does."""
    for frame in frames[len(frames) // 2 : len(frames) // 2 + 120]:
        frame["joints"] = [[0, 0, 0]] * adt.N_NATIVE_JOINTS


def _other_skeleton(frames: list[Any]) -> None:
    for frame in frames:
        frame["joints"] = frame["joints"][:50]


def _strange_serial(content: dict[str, Any]) -> None:
    for person in content["SkeletonMetadata"]:
        person["AssociatedDeviceSerial"] = "1WM103600M9999"


def _other_clock(content: dict[str, Any]) -> None:
    content["gt_time_domain"] = "TIME_CODE"


def _mps_gaze(root: Path, recording: str) -> None:
    """Replace the release's gaze by that of the services: schema and places of another version."""
    folder = root / recording / adt.MPS_FOLDER / "eye_gaze"
    folder.mkdir(parents=True)
    (root / recording / adt.GAZE_FILE).rename(folder / mps.GAZE_FILES[2])


_ANGLES = (mps.YAW, mps.PITCH)
_TRAJECTORY = adt.TRAJECTORY_FILE
_GAZE = adt.GAZE_FILE
_OBJECTS = adt.OBJECTS_FILE
_TIME = mps.TIME_COLUMN
_BACKWARDS = "The clock runs backwards or a row is repeated"

DEFECTS = (
    Defect("missing-metadata", "metadata.json is not there", missing(adt.METADATA_FILE), "failed", adt.METADATA_FILE),
    Defect("missing-instances", "names of objects are not there", missing(adt.INSTANCES_FILE), "failed", "instances"),
    Defect("missing-trajectory", "poses of the glasses are not there", missing(_TRAJECTORY), "failed", _TRAJECTORY),
    Defect("missing-objects", "poses of objects are not there", missing(_OBJECTS), "failed", _OBJECTS),
    Defect("missing-boxes", "boxes of objects are not there", missing(adt.BOXES_FILE), "failed", adt.BOXES_FILE),
    Defect("missing-gaze", "gaze is not there", missing(_GAZE), "failed", _GAZE),
    Defect("mps-gaze", "gaze of the services in place of the release's", _mps_gaze, "read", ""),
    Defect("missing-skeleton", "the wearer's skeleton is not there", removed(_skeleton), "failed", "Skeleton_"),
    Defect("no-skeleton", "nobody wore the suit", _no_skeleton, "read", "no skeleton belongs to the wearer"),
    Defect(
        "strange-serial",
        "the suit belongs to other glasses",
        _content(adt.ASSOCIATION_FILE, _strange_serial),
        "read",
        "no skeleton belongs to the wearer",
    ),
    Defect("truncated-trajectory", "poses of the glasses are cut off", _truncated(_TRAJECTORY), "failed", "truncated"),
    Defect("truncated-objects", "poses of objects are cut off", _truncated(_OBJECTS), "failed", "truncated"),
    Defect("truncated-gaze", "gaze is cut off", _truncated(_GAZE), "failed", "truncated"),
    Defect("truncated-skeleton", "the skeleton is cut off", cut_in_half(_skeleton), "failed", "truncated"),
    Defect(
        "empty-trajectory",
        "a header without poses",
        _rows(_TRAJECTORY, lambda rows: rows[:0]),
        "failed",
        "at least one pose",
    ),
    Defect(
        "nan-gaze",
        "no gaze angle is a number",
        _rows(_GAZE, lambda rows: [row | dict.fromkeys(_ANGLES, "nan") for row in rows]),
        "read",
        "no valid gaze",
    ),
    Defect(
        "gaze-degrees",
        "gaze angles in degrees",
        _rows(_GAZE, _scaled(_ANGLES, 57.29578)),
        "failed",
        "look like degrees",
    ),
    Defect(
        "gaze-nanoseconds",
        "gaze times in nanoseconds",
        _rows(_GAZE, _integers_scaled(_TIME, 1000)),
        "failed",
        "do not overlap",
    ),
    Defect(
        "trajectory-nanoseconds",
        "times of the glasses in nanoseconds",
        _rows(_TRAJECTORY, _integers_scaled(_TIME, 1000)),
        "failed",
        "do not overlap",
    ),
    Defect(
        "slam-gap",
        "a third of the poses is missing",
        _rows(_TRAJECTORY, _without_middle),
        "read",
        "gaps of more than 50 ms",
    ),
    Defect(
        "lost-poses",
        "markers of the glasses out of sight",
        _rows(_TRAJECTORY, _with_middle({mps.QUALITY_COLUMN: "0"})),
        "read",
        "have quality 0",
    ),
    Defect(
        "nan-pose",
        "poses that are no numbers",
        _rows(_TRAJECTORY, _with_middle({mps.POSITION_COLUMNS[0]: "nan"})),
        "failed",
        "a pose of finite numbers",
    ),
    Defect("duplicated-pose", "a pose is there twice", _rows(_TRAJECTORY, _one_twice), "failed", _BACKWARDS),
    Defect("duplicated-gaze", "a gaze row is there twice", _rows(_GAZE, _one_twice), "failed", _BACKWARDS),
    Defect("duplicated-objects", "object rows are there twice", _rows(_OBJECTS, _one_twice), "failed", _BACKWARDS),
    Defect("swapped-poses", "two poses in the wrong order", _rows(_TRAJECTORY, _two_swapped), "failed", _BACKWARDS),
    Defect("swapped-gaze", "two gaze rows in the wrong order", _rows(_GAZE, _two_swapped), "failed", _BACKWARDS),
    Defect(
        "lost-object",
        "a tracked object has no poses",
        _rows(_OBJECTS, _one_object_lost),
        "read",
        "without name, box or pose",
    ),
    Defect(
        "untracked-objects",
        "no object is tracked for a third of the time",
        _rows(_OBJECTS, _objects_untracked),
        "read",
        "",
    ),
    Defect("lost-suit", "the suit is out of sight for a second", _frames(_lost_markers), "read", "are implausible"),
    Defect("other-skeleton", "a skeleton of 50 joints", _frames(_other_skeleton), "failed", "51 joints"),
    Defect(
        "other-clock",
        "ground truth on another clock",
        _content(adt.METADATA_FILE, _other_clock),
        "failed",
        "DEVICE_CAPTURE",
    ),
)
"""What can be done to one recording of a synthetic tree."""
