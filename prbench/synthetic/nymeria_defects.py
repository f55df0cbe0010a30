"""Defects of real copies of Nymeria (docs/specification/nymeria.md#bad-input)."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from prbench.corpora.nymeria import format as nymeria
from prbench.files.storage import atomic_path
from prbench.geometry.joint_names import XSENS_SEGMENTS
from prbench.synthetic.defects import Damage, Defect, change_cells, cut_in_half, removed

_ATOMIC = nymeria.NARRATION_FILES["atomic_action"]
Arrays = dict[str, np.ndarray]


def _suit(root: Path, recording: str) -> Path:
    return root / recording / "body" / nymeria.SUIT_FILE


def _narration(root: Path, recording: str, name: str = _ATOMIC) -> Path:
    return root / recording / "narration" / name


def _on_arrays(change: Callable[[Arrays], None]) -> Damage:
    """Return a damage that changes arrays of the suit's file."""

    def apply(root: Path, recording: str) -> None:
        path = _suit(root, recording)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        change(arrays)
        with atomic_path(path) as temporary:
            np.savez(temporary, **arrays)

    return apply


def _on_rows(change: Callable[[list[list[str]]], list[list[str]]]) -> Damage:
    """Return a damage that changes the rows below the header of the atomic actions."""

    def apply(root: Path, recording: str) -> None:
        path = _narration(root, recording)
        with open(path, encoding="utf-8-sig", newline="") as file:
            header, *rows = list(csv.reader(file))
        with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8-sig", newline="") as file:
            csv.writer(file, quoting=csv.QUOTE_ALL).writerows([header, *change(rows)])

    return apply


def _jump(arrays: Arrays) -> None:
    arrays["timestamps_us"][len(arrays["timestamps_us"]) // 2 :] += 24_003_000_000


def _back_and_forth(arrays: Arrays) -> None:
    """Let the clock jump there and back, which a test of the end point alone lets pass."""
    third = len(arrays["timestamps_us"]) // 3
    arrays["timestamps_us"][third : 2 * third] -= 61_400


def _no_rotation(arrays: Arrays) -> None:
    arrays["segment_qWXYZ"][100:140, 24:28] = 0.0


def _no_position(arrays: Arrays) -> None:
    n = len(arrays["segment_tXYZ"])
    arrays["segment_tXYZ"][n // 4 : n // 4 + 30, 9] = np.nan


def _without(key: str) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        del arrays[key]

    return change


def _another_rate(arrays: Arrays) -> None:
    arrays["frameRate"] = np.array([60])


def _fewer_frames(arrays: Arrays) -> None:
    arrays["segment_qWXYZ"] = arrays["segment_qWXYZ"][:-7]


def _y_up(arrays: Arrays) -> None:
    """Turn another axis up, with the head where the suit has the feet."""
    position = arrays["segment_tXYZ"].reshape(-1, nymeria.N_SEGMENTS, 3)
    arrays["segment_tXYZ"] = position[..., [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    arrays["segment_tXYZ"][..., 2] -= position[..., 2]


def _swapped(arrays: Arrays) -> None:
    for key, size in (("segment_tXYZ", 3), ("segment_qWXYZ", 4)):
        values = arrays[key].reshape(-1, nymeria.N_SEGMENTS, size)
        turned = values.copy()
        for right, name in enumerate(XSENS_SEGMENTS):
            if name.startswith("R_"):
                left = XSENS_SEGMENTS.index(f"L_{name[2:]}")
                turned[:, right], turned[:, left] = values[:, left], values[:, right]
        arrays[key] = turned.reshape(len(values), -1)


def _empty_texts(root: Path, recording: str) -> None:
    for name in nymeria.NARRATION_FILES.values():
        path = _narration(root, recording, name)
        if path.exists():
            path.write_bytes(b"")


def _milliseconds(rows: list[list[str]]) -> list[list[str]]:
    return [[*row[:2], f"{float(row[2]) * 1e3:.3f}", f"{float(row[3]) * 1e3:.3f}", *row[4:]] for row in rows]


def _repeated(rows: list[list[str]]) -> list[list[str]]:
    return [*rows, rows[0]]


def _one_deeper(root: Path, recording: str) -> None:
    inner = root / recording / "unpacked"
    inner.mkdir()
    for path in list((root / recording).iterdir()):
        if path != inner:
            shutil.move(path, inner / path.name)


def _by_group(root: Path, recording: str) -> None:
    for group, part in (("body_motion", "body"), ("narration", "narration")):
        (root / group / recording).mkdir(parents=True)
        shutil.move(root / recording / part, root / group / recording / part)


def _no_mark(root: Path, recording: str) -> None:
    path = _narration(root, recording)
    path.write_bytes(path.read_bytes().removeprefix(b"\xef\xbb\xbf"))


def _another_head(root: Path, recording: str) -> None:
    """Replace the trajectory by one of another recording: the same poses backwards in time."""
    path = root / recording / nymeria.HEAD_FOLDER / "mps" / "slam" / nymeria.TRAJECTORY_FILE
    change_cells(path, lambda rows: [[*row[:2], *other[2:]] for row, other in zip(rows, reversed(rows), strict=True)])


DEFECTS = (
    Defect("clock-jump", "the suit's clock jumps by 24,003 s", _on_arrays(_jump), "read", "cut at 1 jumps"),
    Defect("clock-there-and-back", "jumps that cancel out", _on_arrays(_back_and_forth), "read", "cut at 2 jumps"),
    Defect("zero-quaternions", "a segment loses its rotation", _on_arrays(_no_rotation), "read", "repeat the frame"),
    Defect("nan-positions", "positions of 30 frames are NaN", _on_arrays(_no_position), "read", "30 frames without"),
    Defect("missing-suit", "the suit's file is missing", removed(_suit), "failed", "xdata.npz"),
    Defect("no-timestamps", "the suit has no times", _on_arrays(_without("timestamps_us")), "failed", "timestamps_us"),
    Defect("frames-mismatch", "fewer rotations than times", _on_arrays(_fewer_frames), "failed", "of the shape"),
    Defect("wrong-rate", "the suit ran at 60 Hz", _on_arrays(_another_rate), "failed", "frameRate"),
    Defect("upside-down", "another axis is up", _on_arrays(_y_up), "failed", "Z up"),
    Defect("swapped-sides", "left and right are exchanged", _on_arrays(_swapped), "failed", "Left and right"),
    Defect("cut-archive", "the suit's file is cut in half", cut_in_half(_suit), "failed", "xdata.npz"),
    Defect("empty-narrations", "text files without a byte", _empty_texts, "read", "no texts of the chosen kinds"),
    Defect(
        "no-narrations",
        "no text files",
        lambda root, name: shutil.rmtree(root / name / "narration"),
        "read",
        "no texts",
    ),
    Defect("milliseconds", "text times in milliseconds", _on_rows(_milliseconds), "failed", "milliseconds"),
    Defect("unsorted-rows", "text rows in reverse order", _on_rows(lambda rows: rows[::-1]), "read", ""),
    Defect("repeated-row", "the first text row stands twice", _on_rows(_repeated), "read", ""),
    Defect("no-byte-order-mark", "text without byte order mark", _no_mark, "read", ""),
    Defect("nested", "the sequence lies one level deeper", _one_deeper, "read", ""),
    Defect("by-group", "one folder for each downloaded group", _by_group, "read", ""),
    Defect("another-trajectory", "the glasses' trajectory is of another recording", _another_head, "read", "agree by"),
)
"""All defects of the layout."""
