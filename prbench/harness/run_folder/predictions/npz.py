"""Predictions as ``.npz``: ids beside one array of all motions, or one array a motion named by its id.

``joints`` is padded, (n, N, 22, 3), or holds the frames of all motions after one another, (total, 22, 3); in both
forms ``n_frames`` tells how many frames each has, and a pose may also be 66 numbers.
"""

from __future__ import annotations

import contextlib
import math
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from prbench.errors import InputFileError, PredictionsError
from prbench.files.arrays import Archive, ArrayHeader
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.predictions.rows import IndexedRows, as_float32, is_floating, leading_axes
from prbench.harness.run_folder.scores import GAZE_COLUMNS
from prbench.limits import MOST_MOTIONS

_ID_COLUMNS = ("sequence_id", "opaque_id")
_LARGEST_COLUMN = 1024**3  # bytes of ids or lengths, many times what any table needs
_LARGEST_MOTION = 32 * 1024**2  # bytes of all samples of one sequence, in the form of one array a sequence
_PADDED_FRAMES = 1000  # to which any motion may be padded; wider arrays are refused before they are unpacked
_OPAQUE = re.compile(r"[0-9a-f]{64}")
_FORMS = "(n, N, 22, 3) padded, or (total, 22, 3) after one another, of float32 or float64"


def index_npz(path: Path) -> IndexedRows:
    """Read ids, samples and lengths; of the motions only what their headers say.

    Raises:
        PredictionsError: if the file cannot be read, or arrays are missing, of a wrong kind or do not fit together.
    """
    archive = Archive(path)
    with _as_predictions_error():
        names = set(archive.members)
        if "joints" in names or names & set(_ID_COLUMNS):
            return _index_columns(archive)
        return _index_named(archive)


@dataclass(frozen=True)
class ColumnMotions:
    """All motions in the one array ``joints``."""

    archive: Archive
    starts: Int[np.ndarray, " n"] | None
    """Frame at which each motion begins; None if they are padded, one a row."""
    n_frames: Int[np.ndarray, " n"]
    _unpacked: _Unpacked = field(default_factory=lambda: _Unpacked(), repr=False)

    _rays: dict[str, _Unpacked] = field(
        default_factory=lambda: {name: _Unpacked() for name in GAZE_COLUMNS}, repr=False
    )

    def make_ready(self, together: Iterable[Sequence[int]] = ()) -> None:
        """Check the arrays' checksums; compressed ones are unpacked into temporary files."""
        del together
        with _as_predictions_error():
            self._unpacked.prepare(self.archive, "joints")
            for name, unpacked in self._rays.items():
                if name in self.archive.members:
                    unpacked.prepare(self.archive, name)

    def motions(self, rows: Sequence[int]) -> list[np.ndarray]:
        """See :class:`MotionStore`; of the file only these rows are read."""
        with _as_predictions_error():
            joints = self._unpacked.array(self.archive, "joints")
        return [as_float32(self._frames(joints, row)).reshape(-1, N_JOINTS, 3) for row in rows]

    def gaze(self, rows: Sequence[int]) -> list[np.ndarray]:
        """See :class:`MotionStore`; of the file only these rows are read."""
        with _as_predictions_error():
            arrays = [self._rays[name].array(self.archive, name) for name in GAZE_COLUMNS]
        return [np.stack([as_float32(self._frames(array, row)) for array in arrays], axis=1) for row in rows]

    def _frames(self, array: np.ndarray, row: int) -> np.ndarray:
        n = self.n_frames[row]
        return array[row, :n] if self.starts is None else array[self.starts[row] : self.starts[row] + n]

    def where(self, row: int) -> str:
        """See :class:`MotionStore`."""
        return f"{self.archive.path}, row {row}"


@dataclass(frozen=True)
class NamedMotions:
    """One array a sequence; several samples of a sequence stand in one array."""

    archive: Archive
    keys: tuple[str, ...]
    """Of each row."""
    samples: tuple[int, ...]

    def make_ready(self, together: Iterable[Sequence[int]] = ()) -> None:
        """Nothing has to be done."""

    def motions(self, rows: Sequence[int]) -> list[np.ndarray]:
        """See :class:`MotionStore`."""
        with _as_predictions_error():
            arrays = self.archive.read_all([self.keys[row] for row in rows])
            return [self._of_sample(array, self.samples[row]) for array, row in zip(arrays, rows)]

    def gaze(self, rows: Sequence[int]) -> list[np.ndarray]:
        """Never asked for: one array a sequence has no room for gaze."""
        raise NotImplementedError

    def where(self, row: int) -> str:
        """See :class:`MotionStore`."""
        return f"{self.archive.path}, '{self.keys[row]}'"

    @staticmethod
    def _of_sample(array: np.ndarray, sample: int) -> np.ndarray:
        leading = leading_axes(array.shape) or ()
        motion = array[sample] if len(leading) == 2 else array
        return as_float32(motion).reshape(-1, N_JOINTS, 3)


class _Unpacked:
    """A view of an array in an archive, by way of a temporary file if it is compressed.

    The temporary file lives as long as the object that made it; copies in other processes use the same file.
    """

    def __init__(self) -> None:
        self._path: Path | None = None
        self._folder: tempfile.TemporaryDirectory | None = None
        self._array: np.ndarray | None = None

    def __getstate__(self) -> dict[str, Any]:
        # Neither a temporary folder nor a mapping can travel; the path of the unpacked file can.
        return {"_path": self._path, "_folder": None, "_array": None}

    def prepare(self, archive: Archive, name: str) -> None:
        if archive.stored_as_is(name):
            archive.verify(name)
        elif self._path is None:
            self._folder = tempfile.TemporaryDirectory(prefix="prbench-", ignore_cleanup_errors=True)
            self._path = Path(self._folder.name) / "array.bin"
            archive.unpack(name, self._path)

    def array(self, archive: Archive, name: str) -> np.ndarray:
        """Return one of the archive's arrays as it is stored, mapped into memory where it lies unpacked."""
        if self._array is None:
            if archive.stored_as_is(name):
                self._array = archive.mapped(name)
            else:
                self.prepare(archive, name)
                assert self._path is not None
                self._array = archive.unpacked(name, self._path)
        return self._array


def _index_columns(archive: Archive) -> IndexedRows:
    path = archive.path
    present = list(archive.members)
    id_column = next((name for name in _ID_COLUMNS if name in present), None)
    absent = [name for name in ("joints", "n_frames") if name not in present]
    if id_column is None or absent:
        itself = " These look like conditions, not motions." if "noise_seed" in present and "joints" in absent else ""
        raise PredictionsError(
            f"{path}: expected the arrays opaque_id (or sequence_id), joints and n_frames, found"
            f" {', '.join(sorted(present)[:10])}.{itself} Copy opaque_id, sample and n_frames from the conditions file."
        )
    ids = _ids(archive, id_column)
    n_frames = _whole_numbers(archive, "n_frames", len(ids), smallest=1)
    samples = (
        _whole_numbers(archive, "sample", len(ids), smallest=0) if "sample" in present else np.zeros(len(ids), int)
    )
    padded = _is_padded(archive.header("joints"), path, n_frames)
    starts = None if padded else np.concatenate(([0], np.cumsum(n_frames)))[:-1]
    has_gaze = _has_gaze(archive)
    store = ColumnMotions(archive, starts, n_frames)
    return IndexedRows((path,), id_column, ids, tuple(samples.tolist()), n_frames, store, has_gaze)


def _has_gaze(archive: Archive) -> bool:
    """Return True if both arrays of gaze are there, in the form of the joints.

    Raises:
        PredictionsError: if one is missing, or of another shape.
    """
    present = [name for name in GAZE_COLUMNS if name in archive.members]
    if len(present) == 1:
        raise PredictionsError(
            f"{archive.path}: expected both arrays {' and '.join(GAZE_COLUMNS)}, found {present[0]} alone."
        )
    frames = leading_axes(archive.header("joints").shape)
    for name in present:
        header = archive.header(name)
        if header.shape != (*(frames or ()), 3) or not is_floating(header.dtype):
            expected = ", ".join(map(str, (*(frames or ()), 3)))
            raise PredictionsError(
                f"{archive.path}, '{name}': expected the shape ({expected}) of float32 or float64, as the joints have"
                f" frames, found {header.shape} of {header.dtype}."
            )
    return bool(present)


def _ids(archive: Archive, name: str) -> tuple[str, ...]:
    _require_few(archive.path, math.prod(archive.header(name).shape))
    values = archive.read(name, largest=_LARGEST_COLUMN)
    if values.ndim != 1 or values.dtype.kind not in "US":
        raise PredictionsError(
            f"{archive.path}, '{name}': expected one text a motion, found shape {values.shape} of {values.dtype}."
        )
    texts = np.char.decode(values, "utf-8") if values.dtype.kind == "S" else values
    return tuple(texts.tolist())


def _require_few(path: Path, motions: int) -> None:
    """Refuse more motions than any table has sequences; a header may announce any number of empty ones."""
    if motions > MOST_MOTIONS:
        raise PredictionsError(f"{path}: expected at most {MOST_MOTIONS:,} motions, found {motions:,}.")


def _whole_numbers(archive: Archive, name: str, n: int, *, smallest: int) -> np.ndarray:
    values = archive.read(name, largest=_LARGEST_COLUMN)
    if values.shape != (n,) or values.dtype.kind not in "iu":
        raise PredictionsError(
            f"{archive.path}, '{name}': expected {n} whole numbers, one a motion, found shape {values.shape} of"
            f" {values.dtype}."
        )
    low = np.flatnonzero(values < smallest)
    if low.size:
        raise PredictionsError(
            f"{archive.path}, '{name}', row {low[0]}: expected {smallest} or more, found {values[low[0]]}."
        )
    return values.astype(np.int64)


def _is_padded(header: ArrayHeader, path: Path, n_frames: np.ndarray) -> bool:
    """Return True if ``joints`` has a row a motion, False if it has the frames of all after one another."""
    leading = leading_axes(header.shape)
    if leading is None or len(leading) not in (1, 2) or not is_floating(header.dtype):
        raise PredictionsError(f"{path}, 'joints': expected {_FORMS}, found {header.shape} of {header.dtype}.")
    if len(leading) == 1:
        if leading[0] != n_frames.sum():
            raise PredictionsError(
                f"{path}, 'joints': expected {n_frames.sum()} frames, the sum of n_frames, found {leading[0]}."
            )
        return False
    if leading[0] != len(n_frames):
        raise PredictionsError(f"{path}, 'joints': expected {len(n_frames)} motions, one an id, found {leading[0]}.")
    # Only the header has been read so far: a tiny file may announce terabytes of zeros.
    widest = max(_PADDED_FRAMES, 4 * int(n_frames.max(initial=0)))
    if leading[1] > widest:
        raise PredictionsError(
            f"{path}, 'joints': expected at most {widest} frames, as n_frames needs {n_frames.max(initial=0)}, found"
            f" {leading[1]}. Save joints[:, :n_frames.max()]."
        )
    longer = np.flatnonzero(n_frames > leading[1])
    if longer.size:
        raise PredictionsError(
            f"{path}, 'joints', row {longer[0]}: expected {n_frames[longer[0]]} frames (n_frames), found {leading[1]}."
        )
    return True


def _index_named(archive: Archive) -> IndexedRows:
    """Every array is the motion of the sequence that it is named by."""
    path = archive.path
    if not archive.members:
        raise PredictionsError(f"{path}: expected motions, found no array.")
    keys: list[str] = []
    samples: list[int] = []
    lengths: list[int] = []
    for name, header in archive.headers().items():
        leading = leading_axes(header.shape)
        if leading is None or len(leading) not in (1, 2) or not is_floating(header.dtype):
            raise PredictionsError(
                f"{path}, '{name}': expected (frames, 22, 3), or (samples, frames, 22, 3), of float32 or float64, found"
                f" {header.shape} of {header.dtype}. Instead of one array a motion, the arrays opaque_id, joints and"
                " n_frames may hold them all."
            )
        if header.nbytes > _LARGEST_MOTION:
            raise PredictionsError(
                f"{path}, '{name}': expected at most {_LARGEST_MOTION:,} bytes of one sequence, found"
                f" {header.nbytes:,}."
            )
        drawn = leading[0] if len(leading) == 2 else 1
        _require_few(path, len(keys) + drawn)
        keys += [name] * drawn
        samples += range(drawn)
        lengths += [leading[-1]] * drawn
    id_column = "opaque_id" if all(map(_OPAQUE.fullmatch, keys)) else "sequence_id"
    store = NamedMotions(archive, tuple(keys), tuple(samples))
    return IndexedRows((path,), id_column, tuple(keys), tuple(samples), np.array(lengths, dtype=np.int64), store)


@contextlib.contextmanager
def _as_predictions_error() -> Iterator[None]:
    """Turn errors of the file into errors of the predictions."""
    try:
        yield
    except InputFileError as error:
        raise PredictionsError(str(error)) from error
