"""Defects of real copies of MoGaze (docs/specification/mogaze.md#bad-input)."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.format import STATE_COLUMNS
from prbench.readers.mogaze.synthetic import GOGGLES_ID
from prbench.synthetic.layouts import Damage, Defect, cut_in_half, removed

HUMAN, OBJECTS, GAZE, SEGMENTS = mogaze.PARTS
_BODY_ROWS = mogaze.HUMAN_DATASET
_GAZE_ROWS = mogaze.GAZE_DATASET
_SEGMENT_ROWS = mogaze.SEGMENT_DATASET
_GOGGLES = f"{mogaze.OBJECT_GROUP}/body {GOGGLES_ID}"
_RISE = 0.5  # m


def _file(root: Path, recording: str, part: str) -> Path:
    return root / f"{recording}_{part}.hdf5"


def _objects(root: Path, recording: str) -> Path:
    return _file(root, recording, OBJECTS)


def _gaze(root: Path, recording: str) -> Path:
    return _file(root, recording, GAZE)


def _dataset(file: h5py.File, name: str) -> h5py.Dataset:
    entry = file[name]
    assert isinstance(entry, h5py.Dataset), "we have just written it"
    return entry


def _with_rows(part: str, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Return a damage that writes other rows under the same name, with the same attributes."""

    def apply(root: Path, recording: str) -> None:
        with h5py.File(_file(root, recording, part), "r+") as file:
            entry = _dataset(file, name)
            rows = np.array(entry)
            attributes = dict(entry.attrs)
            del file[name]
            file.create_dataset(name, data=change(rows)).attrs.update(attributes)

    return apply


def _without_last(count: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda rows: rows[:-count]


def _reorder_columns(root: Path, recording: str) -> None:
    order = np.random.default_rng(0).permutation(len(STATE_COLUMNS))
    _with_rows(HUMAN, _BODY_ROWS, lambda rows: rows[:, order])(root, recording)
    with h5py.File(_file(root, recording, HUMAN), "r+") as file:
        names = [STATE_COLUMNS[index] for index in order]
        attributes = _dataset(file, mogaze.HUMAN_DATASET).attrs
        attributes.create(mogaze.COLUMNS_ATTRIBUTE, names, dtype=h5py.string_dtype())


def _forget_fixed_values(root: Path, recording: str) -> None:
    with h5py.File(_file(root, recording, HUMAN), "r+") as file:
        del _dataset(file, mogaze.HUMAN_DATASET).attrs[mogaze.FIXED_KEYS_ATTRIBUTE]


def _forget_goggles(root: Path, recording: str) -> None:
    with h5py.File(_file(root, recording, OBJECTS), "r+") as file:
        del file[_GOGGLES]


def _lose_body_frames(rows: np.ndarray) -> np.ndarray:
    rows[100:140] = np.nan
    return rows


def _lose_goggles(rows: np.ndarray) -> np.ndarray:
    rows[50:80] = np.nan
    rows[200:220, 3:] = 0.0
    return rows


def _doubt_everything(rows: np.ndarray) -> np.ndarray:
    rows[:, -1] = 0.1
    return rows


def _write_metres(rows: np.ndarray) -> np.ndarray:
    rows[:, mogaze.GAZE_POINT] /= 1000.0
    return rows


def _disorder_segments(rows: np.ndarray) -> np.ndarray:
    """Add segments out of order, repeated, ending before they begin, beyond the recording, and of unknown things."""
    bad = [(70, 60, b"null"), (10_000_000, 10_000_100, b"null"), (5, 20, b"spoon")]
    return np.concatenate([rows[::-1], rows[:1], np.array(bad, dtype=rows.dtype)])


def _raise_floor(root: Path, recording: str) -> None:
    with h5py.File(_file(root, recording, OBJECTS), "r") as file:
        bodies = file[mogaze.OBJECT_GROUP]
        assert isinstance(bodies, h5py.Group), "we have just written it"
        names = [f"{mogaze.OBJECT_GROUP}/{key}" for key in bodies]
    height = STATE_COLUMNS.index("baseTransZ")
    _with_rows(HUMAN, _BODY_ROWS, lambda rows: rows + _RISE * np.eye(rows.shape[1])[height])(root, recording)
    for name in names:
        _with_rows(OBJECTS, name, lambda rows: rows + _RISE * np.eye(rows.shape[1])[2])(root, recording)


def _add_stray_files(root: Path, _recording: str) -> None:
    for name in ("p7_1_objects.hdf5", "p7_1_objects.csv"):
        (root / name).write_bytes(b"no recording")


DEFECTS: tuple[Defect, ...] = (
    Defect("missing-gaze", "no gaze file, as for p3_1", removed(_gaze), "failed", "gaze_data.hdf5"),
    Defect("truncated-objects", "half of the object file", cut_in_half(_objects), "failed", "truncated"),
    Defect(
        "foreign-gaze",
        "a gaze file much too short",
        _with_rows(GAZE, _GAZE_ROWS, _without_last(200)),
        "failed",
        "frame index",
    ),
    Defect(
        "short-gaze",
        "a gaze file twenty frames too short",
        _with_rows(GAZE, _GAZE_ROWS, _without_last(20)),
        "read",
        "cut to",
    ),
    Defect("other-columns", "body columns in another order", _reorder_columns, "read", ""),
    Defect("no-scalings", "no scaling values", _forget_fixed_values, "failed", "keys_fixed"),
    Defect(
        "lost-body",
        "a third of a second without body",
        _with_rows(HUMAN, _BODY_ROWS, _lose_body_frames),
        "read",
        "implausible",
    ),
    Defect("no-goggles", "the goggles were not tracked", _forget_goggles, "failed", "goggles"),
    Defect("lost-goggles", "the goggles drop out twice", _with_rows(OBJECTS, _GOGGLES, _lose_goggles), "read", "50 of"),
    Defect(
        "blind-tracker",
        "the eye tracker knows nothing",
        _with_rows(GAZE, _GAZE_ROWS, _doubt_everything),
        "read",
        "no valid gaze",
    ),
    Defect("metres", "gaze points in metres", _with_rows(GAZE, _GAZE_ROWS, _write_metres), "read", "metres"),
    Defect(
        "bad-segments",
        "segments in disorder",
        _with_rows(SEGMENTS, _SEGMENT_ROWS, _disorder_segments),
        "read",
        "left out",
    ),
    Defect(
        "no-segments",
        "an empty list of segments",
        _with_rows(SEGMENTS, _SEGMENT_ROWS, lambda rows: rows[:0]),
        "read",
        "no segments",
    ),
    Defect("raised-floor", "the floor is at half a metre", _raise_floor, "read", "floor is moved"),
    Defect(
        "no-scene",
        "no scene.xml, and other bodies than the release has",
        lambda root, _: (root / mogaze.SCENE_FILE).unlink(),
        "failed",
        "scene.xml",
    ),
    Defect(
        "no-meshes",
        "meshes not copied",
        lambda root, _: shutil.rmtree(root / mogaze.MESH_FOLDER),
        "read",
        "no mesh and no known size",
    ),
    Defect("stray-files", "files of the release that are no recording", _add_stray_files, "read", ""),
)
