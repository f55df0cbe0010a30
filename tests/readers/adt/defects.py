"""Defects of real copies of Aria Digital Twin (docs/specification/adt.md#pitfalls-and-bad-input)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

from prbench.files.storage import write_json
from prbench.readers.adt import format as adt
from prbench.readers.aria_mps import format as mps
from tests.readers.defects import Damage, Defect, Row, changed_rows, cut_in_half, missing

_ANGLES = (mps.YAW, mps.PITCH)
_TRAJECTORY = adt.TRAJECTORY_FILE
_GAZE = adt.GAZE_FILE
_DEGREES = 57.29578  # in a radian


def _rows(name: str, change: Callable[[list[Row]], Iterable[Row]]) -> Damage:
    """Return a damage that changes the rows of a CSV file."""

    def rewrite(root: Path, recording: str) -> None:
        path = root / recording / name
        path.write_text(changed_rows(path.read_text(), change))

    return rewrite


def _each(name: str, change: Callable[[Row], Row]) -> Damage:
    """Return a damage that changes every row of a CSV file."""
    return _rows(name, lambda rows: [row | change(row) for row in rows])


def _middle(rows: list[Row]) -> range:
    return range(len(rows) // 3, 2 * len(rows) // 3)


def _cut_in_a_number(root: Path, recording: str) -> None:
    """Cut the poses of the glasses in the middle of a number, as a copy that stopped."""
    path = root / recording / _TRAJECTORY
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b".", 0, len(content) // 2) + 2])


def _one_object_lost(rows: list[Row]) -> list[Row]:
    """Remove all poses of one tracked object."""
    lost = min(row[mps.OBJECT_ID] for row in rows if row[mps.OBJECT_TIME] != str(adt.STATIC_TIME))
    return [row for row in rows if row[mps.OBJECT_ID] != lost]


def _objects_untracked(rows: list[Row]) -> list[Row]:
    """Remove all poses of objects in the middle third of the recording."""
    times = sorted({int(row[mps.OBJECT_TIME]) for row in rows} - {adt.STATIC_TIME})
    first = times[len(times) // 3]
    last = times[2 * len(times) // 3]
    return [row for row in rows if not first <= int(row[mps.OBJECT_TIME]) < last]


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


def _lost_markers(root: Path, recording: str) -> None:
    """Move all joints to the origin for a second, as a suit out of sight does."""
    path = _skeleton(root, recording)
    content = json.loads(path.read_text())
    frames = content["frames"]
    for frame in frames[len(frames) // 2 : len(frames) // 2 + 120]:
        frame["joints"] = [[0, 0, 0]] * adt.N_NATIVE_JOINTS
    path.write_text(json.dumps(content))


def _mps_gaze(root: Path, recording: str) -> None:
    """Replace the release's gaze by that of the services: schema and places of another version."""
    folder = root / recording / adt.MPS_FOLDER / "eye_gaze"
    folder.mkdir(parents=True)
    (root / recording / _GAZE).rename(folder / mps.GAZE_FILES[2])


_NO_ANGLES = _each(_GAZE, lambda _row: dict.fromkeys(_ANGLES, "nan"))
_IN_DEGREES = _each(_GAZE, lambda row: {name: repr(float(row[name]) * _DEGREES) for name in _ANGLES if row[name]})
_IN_NANOSECONDS = _each(_GAZE, lambda row: {mps.TIME_COLUMN: str(int(row[mps.TIME_COLUMN]) * 1000)})
_NO_MIDDLE = _rows(_TRAJECTORY, lambda rows: [row for n, row in enumerate(rows) if n not in _middle(rows)])
_OUT_OF_SIGHT = _rows(
    _TRAJECTORY,
    lambda rows: [row | ({mps.QUALITY_COLUMN: "0"} if n in _middle(rows) else {}) for n, row in enumerate(rows)],
)
_ONE_TWICE = _rows(_TRAJECTORY, lambda rows: [*rows[: len(rows) // 2], *rows[len(rows) // 2 - 1 :]])
_ONE_LOST = _rows(adt.OBJECTS_FILE, _one_object_lost)
_UNTRACKED = _rows(adt.OBJECTS_FILE, _objects_untracked)

DEFECTS = (
    Defect("missing-trajectory", "poses of the glasses are not there", missing(_TRAJECTORY), "failed", _TRAJECTORY),
    Defect("missing-gaze", "gaze is not there", missing(_GAZE), "failed", _GAZE),
    Defect("mps-gaze", "gaze of the services in place of the release's", _mps_gaze, "read", ""),
    Defect("no-skeleton", "nobody wore the suit", _no_skeleton, "read", "no skeleton belongs to the wearer"),
    Defect("truncated-trajectory", "poses of the glasses are cut off", _cut_in_a_number, "failed", "truncated"),
    Defect("truncated-skeleton", "the skeleton is cut off", cut_in_half(_skeleton), "failed", "truncated"),
    Defect("nan-gaze", "no gaze angle is a number", _NO_ANGLES, "read", "no valid gaze"),
    Defect("gaze-degrees", "gaze angles in degrees", _IN_DEGREES, "failed", "look like degrees"),
    Defect("gaze-nanoseconds", "gaze times in nanoseconds", _IN_NANOSECONDS, "failed", "do not overlap"),
    Defect("slam-gap", "a third of the poses is missing", _NO_MIDDLE, "read", "gaps of more"),
    Defect("lost-poses", "glasses out of sight", _OUT_OF_SIGHT, "read", "have quality 0"),
    Defect("duplicated-pose", "a pose is there twice", _ONE_TWICE, "failed", "a row is repeated"),
    Defect("lost-object", "an object has no poses", _ONE_LOST, "read", "box or pose"),
    Defect("untracked-objects", "no object is tracked for a third", _UNTRACKED, "read", ""),
    Defect("lost-suit", "the suit is out of sight for a second", _lost_markers, "read", "are implausible"),
)
