"""Predictions in the layout of the authors' release: ``motions/%010d.npy``, the number a row of a conditions file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.bounded import open_regular
from prbench.errors import InputFileError, PredictionsError
from prbench.numpy_files import ArrayHeader, map_array, read_header
from prbench.runs.predictions.rows import IndexedRows, Numbering, as_float32, leading_axes
from prbench.skeleton import N_JOINTS

FOLDER = "motions"
_NAME = re.compile(r"\d+\.npy", re.ASCII)
_FORM = "the shape (frames, 22, 3) or (frames, 66) of float32 or float64"


def numbered_folder(path: Path) -> Path | None:
    """The folder of numbered motions that a path means: itself or its ``motions``; None if there is none."""
    if (path / FOLDER).is_dir():
        return path / FOLDER
    return path if path.name == FOLDER or any(path.glob("*.npy")) else None


def index_numbered(folder: Path, numbering: Numbering | None) -> IndexedRows:
    """Read names and headers of all files.

    Args:
        folder: Holds the ``.npy`` files.
        numbering: What their numbers mean.

    Raises:
        PredictionsError: if there are more or fewer files than rows, or a name or a header is wrong.
    """
    if numbering is None:
        raise PredictionsError(
            f"{folder}: expected to be told what the numbers of the files mean. Add --conditions FILE, the file of"
            " `prbench export-conditions` that the motions were made from; the number is the row in it, from 0."
        )
    paths = _paths(folder, numbering)
    headers = [_header(path) for path in paths]
    lengths = np.array([header.shape[0] for header in headers], dtype=np.int64)
    return IndexedRows(paths, "opaque_id", numbering.ids, numbering.samples, lengths, NumberedMotions(paths))


@dataclass(frozen=True)
class NumberedMotions:
    """One file a motion."""

    paths: tuple[Path, ...]

    def make_ready(self) -> None:
        """Nothing has to be done."""

    def motions(self, rows: Sequence[int]) -> list[np.ndarray]:
        """See :class:`MotionStore`."""
        return [_motion(self.paths[row]) for row in rows]

    def where(self, row: int) -> str:
        """See :class:`MotionStore`."""
        return str(self.paths[row])


def _paths(folder: Path, numbering: Numbering) -> tuple[Path, ...]:
    """The file of each row."""
    rows = len(numbering.ids)
    by_number: dict[int, Path] = {}
    for path in sorted(path for path in folder.glob("*.npy") if path.name[0] != "."):
        if not _NAME.fullmatch(path.name):
            raise PredictionsError(f"{path}: expected a number as name, such as 0000000012.npy, found '{path.name}'.")
        number = int(path.stem)
        if number >= rows:
            one = " The files seem to count from 1; count from 0." if number == rows and 0 not in by_number else ""
            raise PredictionsError(
                f"{path}: expected a number below {rows}, the rows of {numbering.source}, found {number}.{one}"
            )
        if number in by_number:
            raise PredictionsError(f"{path}: expected each number once, found {number} in {by_number[number]}, too.")
        by_number[number] = path
    missing = [row for row in range(rows) if row not in by_number]
    if missing:
        raise PredictionsError(
            f"{folder}: expected {rows} files, one a row of {numbering.source}, found {len(by_number)}; the first that"
            f" is missing is {missing[0]:010d}.npy."
        )
    return tuple(by_number[row] for row in range(rows))


def _header(path: Path) -> ArrayHeader:
    try:
        with open_regular(path) as file:
            header = read_header(file, path, "")
    except InputFileError as error:
        raise PredictionsError(str(error)) from error
    leading = leading_axes(header.shape)
    if leading is None or len(leading) != 1 or header.dtype.kind != "f" or header.dtype.itemsize not in (4, 8):
        raise PredictionsError(f"{path}: expected {_FORM}, found {header.shape} of {header.dtype}.")
    return header


def _motion(path: Path) -> np.ndarray:
    header = _header(path)
    try:
        return as_float32(map_array(path, header)).reshape(-1, N_JOINTS, 3)
    except InputFileError as error:
        raise PredictionsError(str(error)) from error
