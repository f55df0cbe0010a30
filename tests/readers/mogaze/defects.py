"""Defects of real copies of MoGaze (docs/specification/mogaze.md#bad-input)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.format import STATE_COLUMNS
from prbench.readers.mogaze.synthetic import GOGGLES_ID
from tests.readers.defects import Damage, Defect, cut_in_half, removed

HUMAN, OBJECTS, GAZE, SEGMENTS = mogaze.PARTS
_RISE = 0.5  # m


def _file(part: str) -> Callable[[Path, str], Path]:
    return lambda root, recording: root / f"{recording}_{part}.hdf5"


def _with_rows(part: str, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Return a damage that writes other rows under the same name, with the same attributes."""

    def apply(root: Path, recording: str) -> None:
        with h5py.File(_file(part)(root, recording), "r+") as file:
            rows = np.array(file[name])
            attributes = dict(file[name].attrs)
            del file[name]
            file.create_dataset(name, data=change(rows)).attrs.update(attributes)

    return apply


def _forget(part: str, of: Callable[[h5py.File], Any], key: str) -> Damage:
    """Return a damage that removes one entry of what ``of`` takes from a file."""

    def apply(root: Path, recording: str) -> None:
        with h5py.File(_file(part)(root, recording), "r+") as file:
            del of(file)[key]

    return apply


def _disorder_segments(rows: np.ndarray) -> np.ndarray:
    """Add segments out of order, repeated, ending before they begin, beyond the recording, and of unknown things."""
    bad = [(70, 60, b"null"), (10_000_000, 10_000_100, b"null"), (5, 20, b"spoon")]
    return np.concatenate([rows[::-1], rows[:1], np.array(bad, dtype=rows.dtype)])


def _raise_floor(root: Path, recording: str) -> None:
    with h5py.File(_file(OBJECTS)(root, recording), "r") as file:
        names = [f"{mogaze.OBJECT_GROUP}/{key}" for key in file.require_group(mogaze.OBJECT_GROUP)]
    heights = [(HUMAN, mogaze.HUMAN_DATASET, STATE_COLUMNS.index("baseTransZ"))]
    heights += [(OBJECTS, name, 2) for name in names]
    for part, name, column in heights:
        raised = _with_rows(part, name, lambda rows, column=column: rows + _RISE * np.eye(rows.shape[1])[column])
        raised(root, recording)


_SHORTER = _with_rows(GAZE, mogaze.GAZE_DATASET, lambda rows: rows[:-20])
_NO_BODY = _with_rows(
    HUMAN, mogaze.HUMAN_DATASET, lambda rows: np.concatenate([rows[:100], rows[100:140] * np.nan, rows[140:]])
)
_BLIND = _with_rows(GAZE, mogaze.GAZE_DATASET, lambda rows: np.column_stack([rows[:, :-1], np.full(len(rows), 0.1)]))
_DISORDER = _with_rows(SEGMENTS, mogaze.SEGMENT_DATASET, _disorder_segments)

_UNSCALED = _forget(HUMAN, lambda file: file[mogaze.HUMAN_DATASET].attrs, mogaze.FIXED_KEYS_ATTRIBUTE)
_NO_GOGGLES = _forget(OBJECTS, lambda file: file[mogaze.OBJECT_GROUP], f"body {GOGGLES_ID}")
_NO_SCENE = removed(lambda root, _recording: root / mogaze.SCENE_FILE)

DEFECTS: tuple[Defect, ...] = (
    Defect("missing-gaze", "no gaze file, as for p3_1", removed(_file(GAZE)), "failed", "gaze_data.hdf5"),
    Defect("truncated-objects", "half of the object file", cut_in_half(_file(OBJECTS)), "failed", "truncated"),
    Defect("short-gaze", "a gaze file twenty frames too short", _SHORTER, "read", "cut to"),
    Defect("no-scalings", "no scaling values", _UNSCALED, "failed", "keys_fixed"),
    Defect("lost-body", "a third of a second without body", _NO_BODY, "read", "implausible"),
    Defect("no-goggles", "the goggles were not tracked", _NO_GOGGLES, "failed", "goggles"),
    Defect("blind-tracker", "the eye tracker knows nothing", _BLIND, "read", "no valid gaze"),
    Defect("bad-segments", "segments in disorder", _DISORDER, "read", "left out"),
    Defect("raised-floor", "the floor is at half a metre", _raise_floor, "read", "floor is moved"),
    Defect("no-scene", "no scene.xml, and other bodies than the release has", _NO_SCENE, "failed", "scene.xml"),
)
