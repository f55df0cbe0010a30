"""Defects of copies of Nymeria."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from prbench.geometry.skeleton import XSENS_SEGMENTS
from prbench_adapters.corpora.nymeria import format as nymeria
from tests.readers.defects import Defect, change_cells, cut_in_half, removed

_ATOMIC = nymeria.NARRATION_FILES["atomic_action"]


def _suit(root: Path, recording: str) -> Path:
    return root / recording / "body" / nymeria.SUIT_FILE


# Damages are these functions with their first arguments given (`partial`).


def _on_arrays(keys: Sequence[str], change: Callable[[np.ndarray], np.ndarray], root: Path, recording: str) -> None:
    """Change some arrays of the suit's file."""
    path = _suit(root, recording)
    with np.load(path, allow_pickle=False) as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays |= {key: change(arrays[key]) for key in keys}
    np.savez(path, **arrays)


def _filled(values: np.ndarray, places: tuple[slice | int, ...], value: float) -> np.ndarray:
    """Return an array with another value in some places."""
    filled = values.copy()
    filled[places] = value
    return filled


def _swapped(values: np.ndarray) -> np.ndarray:
    """Exchange the segments of the left and of the right side."""
    turned = values.reshape(len(values), nymeria.N_SEGMENTS, -1)
    other = {"R_": "L_", "L_": "R_"}
    order = [XSENS_SEGMENTS.index(other.get(name[:2], name[:2]) + name[2:]) for name in XSENS_SEGMENTS]
    return turned[:, order].reshape(len(values), -1)


def _on_rows(change: Callable[[list[list[str]]], list[list[str]]], root: Path, recording: str) -> None:
    """Change the rows below the header of the atomic actions."""
    path = root / recording / "narration" / _ATOMIC
    with open(path, encoding="utf-8-sig", newline="") as file:
        header, *rows = list(csv.reader(file))
    with open(path, "w", encoding="utf-8-sig", newline="") as file:
        csv.writer(file, quoting=csv.QUOTE_ALL).writerows([header, *change(rows)])


def _on_bytes(names: Sequence[str], change: Callable[[bytes], bytes], root: Path, recording: str) -> None:
    """Change the bytes of some narration files, where they exist."""
    for path in (root / recording / "narration" / name for name in names):
        if path.exists():
            path.write_bytes(change(path.read_bytes()))


def _moved(folder_of: Callable[[Path, str, str], Path], root: Path, recording: str) -> None:
    """Move body, narrations and all else of a sequence into other folders."""
    for path in sorted((root / recording).iterdir()):
        folder = folder_of(root, recording, path.name)
        if folder != path.parent:
            folder.mkdir(parents=True, exist_ok=True)
            shutil.move(path, folder / path.name)


def _another_head(root: Path, recording: str) -> None:
    """Replace the trajectory by one of another recording: the same poses backwards in time."""
    path = root / recording / nymeria.HEAD_FOLDER / "mps" / "slam" / nymeria.TRAJECTORY_FILE
    change_cells(path, lambda rows: [[*row[:2], *other[2:]] for row, other in zip(rows, reversed(rows), strict=True)])


_POSITIONS = "segment_tXYZ"
_ROTATIONS = "segment_qWXYZ"
_GROUPS = {"body": "body_motion", "narration": "narration"}  # folder of each download group
_NO_ROTATION = partial(_on_arrays, [_ROTATIONS], lambda values: _filled(values, np.s_[100:140, 24:28], 0.0))
_NO_POSITION = partial(
    _on_arrays, [_POSITIONS], lambda values: _filled(values, np.s_[len(values) // 4 : len(values) // 4 + 30, 9], np.nan)
)
_JUMP = partial(
    _on_arrays, ["timestamps_us"], lambda times: times + 24_003_000_000 * (np.arange(len(times)) >= len(times) // 2)
)
_MILLISECONDS = partial(
    _on_rows, lambda rows: [[*row[:2], *(f"{float(cell) * 1e3:.3f}" for cell in row[2:4]), *row[4:]] for row in rows]
)
_DEEPER = partial(_moved, lambda root, recording, _: root / recording / "unpacked")
_BY_GROUP = partial(
    _moved, lambda root, recording, part: root / _GROUPS[part] / recording if part in _GROUPS else root / recording
)
_NO_MARK = partial(_on_bytes, [_ATOMIC], lambda content: content.removeprefix(b"\xef\xbb\xbf"))
_EMPTY_TEXTS = partial(_on_bytes, list(nymeria.NARRATION_FILES.values()), lambda _: b"")
# All defects of the layout.
DEFECTS = (
    Defect("clock-jump", "the suit's clock jumps by 24,003 s", _JUMP, "read", "cut at 1 jumps"),
    Defect("zero-quaternions", "a segment loses its rotation", _NO_ROTATION, "read", "repeat the frame"),
    Defect("nan-positions", "positions of 30 frames are NaN", _NO_POSITION, "read", "30 frames without"),
    Defect("missing-suit", "the suit's file is missing", removed(_suit), "failed", "xdata.npz"),
    Defect(
        "swapped-sides",
        "left and right are exchanged",
        partial(_on_arrays, [_POSITIONS, _ROTATIONS], _swapped),
        "failed",
        "Left and right",
    ),
    Defect("cut-archive", "the suit's file is cut in half", cut_in_half(_suit), "failed", "xdata.npz"),
    Defect("empty-narrations", "text files without a byte", _EMPTY_TEXTS, "read", "no texts of the chosen kinds"),
    Defect("milliseconds", "text times in milliseconds", _MILLISECONDS, "failed", "milliseconds"),
    Defect("unsorted-rows", "text rows in reverse order", partial(_on_rows, lambda rows: rows[::-1]), "read", ""),
    Defect(
        "repeated-row", "the first text row stands twice", partial(_on_rows, lambda rows: [*rows, rows[0]]), "read", ""
    ),
    Defect("no-byte-order-mark", "text without byte order mark", _NO_MARK, "read", ""),
    Defect("nested", "the sequence lies one level deeper", _DEEPER, "read", ""),
    Defect("by-group", "one folder for each downloaded group", _BY_GROUP, "read", ""),
    Defect("another-trajectory", "the glasses' trajectory is of another recording", _another_head, "read", "agree by"),
)
