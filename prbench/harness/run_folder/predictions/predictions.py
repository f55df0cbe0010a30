"""Motions on disk, whatever the format: which there are, and single ones in any order."""

from __future__ import annotations

import itertools
import re
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prbench.errors import InputFileError, PredictionsError
from prbench.files.arrays import ArrayHeader, map_array, read_header
from prbench.files.bounded import foreign_input, open_regular
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.predictions.npz import index_npz
from prbench.harness.run_folder.predictions.parquet import index_parquet
from prbench.harness.run_folder.predictions.rows import (
    IndexedRows,
    Numbering,
    PredictionRows,
    as_float32,
    is_floating,
    leading_axes,
)

FOLDER = "motions"
_NAME = re.compile(r"\d+\.npy", re.ASCII)
_FORM = "the shape (frames, 22, 3) or (frames, 66) of float32 or float64"


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
    return IndexedRows(paths, "opaque_id", numbering.ids, numbering.samples, lengths, _NumberedMotions(paths))


@dataclass(frozen=True)
class _NumberedMotions:
    """One file a motion."""

    paths: tuple[Path, ...]

    def make_ready(self, together: Iterable[Sequence[int]] = ()) -> None:
        """Nothing has to be done."""

    def motions(self, rows: Sequence[int]) -> list[np.ndarray]:
        """See :class:`MotionStore`."""
        return [_motion(self.paths[row]) for row in rows]

    def gaze(self, rows: Sequence[int]) -> list[np.ndarray]:
        """Never asked for: numbered files hold joints alone."""
        raise NotImplementedError

    def where(self, row: int) -> str:
        """See :class:`MotionStore`."""
        return str(self.paths[row])


@dataclass(frozen=True)
class Predictions(IndexedRows):
    """Finished motions with an index of them."""

    rows: Int[np.ndarray, " n"] | None = None
    """Row of every motion in the store, where the store holds more motions; None where they are the same."""

    @classmethod
    @foreign_input()
    def open(cls, path: Path | str, *, numbering: Numbering | None = None) -> Predictions:
        """Index finished motions; none is read.

        Args:
            path: A Parquet file or a folder of such (sequence_id or opaque_id, sample, joints), an ``.npz`` file, or a
                folder of ``motions/%010d.npy``.
            numbering: What the numbers of the last form mean.

        Raises:
            PredictionsError: if there is none, or it is not of one of these forms.
        """
        return cls(**vars(_indexed(Path(path), numbering)))

    def only(self, ids: Sequence[str], samples: Sequence[int]) -> Predictions:
        """Return some of the motions, without the index of all others.

        Args:
            ids: Their ids.
            samples: Their samples; every id has each of them.
        """
        keys = [(name, sample) for sample in samples for name in ids]
        places = np.array([self._place(*key) for key in keys], dtype=np.int64)
        return replace(
            self,
            ids=tuple(name for name, _ in keys),
            samples=tuple(sample for _, sample in keys),
            n_frames=None if self.n_frames is None else self.n_frames[places],
            rows=places if self.rows is None else self.rows[places],
        )

    @cached_property
    def _is_sorted(self) -> bool:
        """True if there is one motion an id, and the ids are sorted: then no table of them is needed."""
        return len(set(self.samples)) == 1 and all(one < other for one, other in itertools.pairwise(self.ids))

    @cached_property
    def _place_of(self) -> dict[int, dict[str, int]]:
        """Maps a sample, then an id to the place; of repeated ones to the last."""
        places: dict[int, dict[str, int]] = {}
        for place, (name, sample) in enumerate(zip(self.ids, self.samples)):
            places.setdefault(sample, {})[name] = place
        return places

    def _find(self, name: str, sample: int) -> int | None:
        """Return the place of a motion in the index, or None if it is not there."""
        if not self._is_sorted:
            return self._place_of.get(sample, {}).get(name)
        place = bisect_left(self.ids, name)
        there = place < len(self.ids) and self.ids[place] == name and self.samples[place] == sample
        return place if there else None

    def _place(self, name: str, sample: int) -> int:
        place = self._find(name, sample)
        if place is None:
            raise KeyError((name, sample))
        return place

    def _row(self, name: str, sample: int) -> int:
        """Return the row of a motion in the store."""
        place = self._place(name, sample)
        return place if self.rows is None else int(self.rows[place])

    def __contains__(self, key: tuple[str, int]) -> bool:
        return self._find(*key) is not None

    @property
    def repeats(self) -> bool:
        """True if several motions have the same id and sample."""
        return not self._is_sorted and sum(map(len, self._place_of.values())) < len(self.ids)

    @foreign_input()
    def make_ready(self, together: Iterable[Sequence[str]] = ()) -> None:
        """Unpack what single motions cannot be read from; call it before the motions go to several processes.

        Args:
            together: Ids whose motions of one sample will be asked for together, as far as that is known.
        """
        samples = sorted(set(self.samples))
        self.store.make_ready([self._row(name, sample) for name in names] for names in together for sample in samples)

    def length(self, name: str, sample: int) -> int | None:
        """Frames of a motion, if they are known without reading it."""
        return None if self.n_frames is None else int(self.n_frames[self._place(name, sample)])

    def where(self, name: str, sample: int) -> str:
        """The file that a motion stands in and its place there, for messages."""
        return self.store.where(self._row(name, sample))

    @foreign_input()
    def motions(self, ids: Sequence[str], sample: int) -> PredictionRows:
        """The motions of the given sequences, in the given order; float32, as a run keeps them.

        Raises:
            PredictionsError: if a motion is empty, damaged, a frame does not have 22 joints, or gaze has other frames
                than the joints.
        """
        rows = [self._row(name, sample) for name in ids]
        found = self.store.motions(rows)
        lengths = [len(motion) for motion in found]
        if 0 in lengths:
            i = lengths.index(0)
            raise PredictionsError(f"{self.store.where(rows[i])}, {ids[i]}: expected a motion, found no frames.")
        gaze = self._gaze(rows, ids, lengths) if self.has_gaze else None
        return PredictionRows(as_float32(np.concatenate(found)), np.concatenate(([0], np.cumsum(lengths))), gaze)

    def _gaze(self, rows: Sequence[int], ids: Sequence[str], lengths: Sequence[int]) -> np.ndarray:
        rays = self.store.gaze(rows)
        for row, name, own, frames in zip(rows, ids, rays, lengths, strict=True):
            if len(own) != frames:
                raise PredictionsError(
                    f"{self.store.where(row)}, {name}: expected gaze in each of its {frames} frames, found {len(own)}."
                )
        return as_float32(np.concatenate(rays))


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
    if leading is None or len(leading) != 1 or not is_floating(header.dtype):
        raise PredictionsError(f"{path}: expected {_FORM}, found {header.shape} of {header.dtype}.")
    return header


def _motion(path: Path) -> np.ndarray:
    header = _header(path)
    try:
        return as_float32(map_array(path, header)).reshape(-1, N_JOINTS, 3)
    except InputFileError as error:
        raise PredictionsError(str(error)) from error


def _indexed(path: Path, numbering: Numbering | None) -> IndexedRows:
    if path.suffix.lower() == ".npz" and not path.is_dir():
        return index_npz(path)
    if not path.is_dir():
        _require_parquet(path)
        return index_parquet((path,))
    if folder := _numbered_folder(path):
        return index_numbered(folder, numbering)
    parts = tuple(sorted(part for part in path.glob("*.parquet") if part.name[0] != "."))
    if not parts:
        raise PredictionsError(f"{path}: expected predictions (*.parquet), found none.")
    return index_parquet(parts)


def _require_parquet(path: Path) -> None:
    """Name the formats where a file with another suffix than Parquet's is not Parquet, either."""
    if path.suffix.lower() == ".parquet" or not path.is_file():
        return  # said by what reads it
    with open(path, "rb") as file:
        if file.read(4) == b"PAR1":
            return
    raise PredictionsError(
        f"{path}: expected Parquet, .npz, or a folder of motions/0000000000.npy …, found a file of another kind."
        " Pickles and torch files are never loaded: save the arrays with np.savez."
    )


def _numbered_folder(path: Path) -> Path | None:
    """The folder of numbered motions that a path means: itself or its ``motions``; None if there is none."""
    if (path / FOLDER).is_dir():
        return path / FOLDER
    return path if path.name == FOLDER or any(path.glob("*.npy")) else None
