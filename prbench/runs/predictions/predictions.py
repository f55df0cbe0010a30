"""Motions on disk, whatever the format: which there are, and single ones in any order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prbench.boundary import foreign_input
from prbench.errors import PredictionsError
from prbench.runs.predictions.npz import index_npz
from prbench.runs.predictions.numbered import index_numbered, numbered_folder
from prbench.runs.predictions.parquet import index_parquet
from prbench.runs.predictions.rows import IndexedRows, MotionStore, Numbering, PredictionRows, as_float32


@dataclass(frozen=True)
class Predictions:
    """Finished motions with an index of them."""

    paths: tuple[Path, ...]
    id_column: str
    """``sequence_id`` or ``opaque_id``."""
    ids: tuple[str, ...]
    """Of every motion, in the order of the files."""
    samples: tuple[int, ...]
    n_frames: Int[np.ndarray, " n"] | None
    """Of every motion; None where only the motions themselves tell (Parquet)."""
    _store: MotionStore = field(repr=False)
    _row_of: dict[tuple[str, int], int] = field(repr=False)
    """(id, sample) → row; of repeated ones the last."""

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
        path = Path(path)
        rows = _indexed(path, numbering)
        row_of = {key: row for row, key in enumerate(zip(rows.ids, rows.samples))}
        return cls(rows.paths, rows.id_column, rows.ids, rows.samples, rows.n_frames, rows.store, row_of)

    def __contains__(self, key: tuple[str, int]) -> bool:
        return key in self._row_of

    @foreign_input()
    def make_ready(self) -> None:
        """Unpack what single motions cannot be read from; call it before the motions go to several processes."""
        self._store.make_ready()

    def length(self, name: str, sample: int) -> int | None:
        """Frames of a motion, if they are known without reading it."""
        return None if self.n_frames is None else int(self.n_frames[self._row_of[name, sample]])

    def where(self, name: str, sample: int) -> str:
        """The file that a motion stands in and its place there, for messages."""
        return self._store.where(self._row_of[name, sample])

    @foreign_input()
    def motions(self, ids: Sequence[str], sample: int) -> PredictionRows:
        """The motions of the given sequences, in the given order; float32, as a run keeps them.

        Raises:
            PredictionsError: if a motion is empty, damaged, or a frame does not have 22 joints.
        """
        rows = [self._row_of[name, sample] for name in ids]
        found = self._store.motions(rows)
        lengths = [len(motion) for motion in found]
        if 0 in lengths:
            i = lengths.index(0)
            raise PredictionsError(f"{self._store.where(rows[i])}, {ids[i]}: expected a motion, found no frames.")
        return PredictionRows(as_float32(np.concatenate(found)), np.concatenate(([0], np.cumsum(lengths))))


def _indexed(path: Path, numbering: Numbering | None) -> IndexedRows:
    if path.suffix.lower() == ".npz" and not path.is_dir():
        return index_npz(path)
    if not path.is_dir():
        _require_parquet(path)
        return index_parquet((path,))
    if folder := numbered_folder(path):
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
