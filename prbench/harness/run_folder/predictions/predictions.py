"""Motions on disk, whatever the format: which there are, and single ones in any order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prbench.errors import PredictionsError
from prbench.files.bounded import foreign_input
from prbench.harness.run_folder.predictions.npz import read_npz
from prbench.harness.run_folder.predictions.parquet import ParquetMotions, index_parquet
from prbench.harness.run_folder.predictions.rows import ArrayMotions, PredictionRows, as_float32


@dataclass(frozen=True)
class Predictions:
    """Finished motions with an index of them.

    Attributes:
        id_column: ``sequence_id`` or ``opaque_id``.
        ids: Id of every motion, in the order of the files.
        has_gaze: True if every motion comes with gaze.
        rows: Row of every motion in the store, where the store holds more motions; None where they are the same.
    """

    paths: tuple[Path, ...]
    id_column: str
    ids: tuple[str, ...]
    samples: tuple[int, ...]
    store: ParquetMotions | ArrayMotions
    has_gaze: bool = False
    rows: Int[np.ndarray, " n"] | None = None

    @classmethod
    @foreign_input()
    def open(cls, path: Path | str) -> Predictions:
        """Index finished motions; those in Parquet are read when they are asked for.

        Args:
            path: A Parquet file or a folder of such (sequence_id or opaque_id, sample, joints), or an ``.npz`` file.

        Raises:
            PredictionsError: if there is none, or it is not of one of these forms.
        """
        path = Path(path)
        if path.is_dir():
            parts = tuple(sorted(part for part in path.glob("*.parquet") if part.name[0] != "."))
            if not parts:
                raise PredictionsError(f"{path}: expected predictions (*.parquet), found none.")
            return cls(**index_parquet(parts))
        if path.suffix.lower() == ".npz":
            return cls(**read_npz(path))
        if path.suffix.lower() != ".parquet" and path.is_file():
            with open(path, "rb") as file:
                if file.read(4) != b"PAR1":
                    raise PredictionsError(
                        f"{path}: expected Parquet, .npz, or a folder of Parquet files, found a file of another kind."
                        " Pickles and torch files are never loaded: save the arrays with np.savez."
                    )
        return cls(**index_parquet((path,)))

    def only(self, ids: Sequence[str], samples: Sequence[int]) -> Predictions:
        """Return some of the motions, without the index of all others.

        Args:
            ids: Their ids.
            samples: Their samples; every id has each of them.
        """
        keys = [(name, sample) for sample in samples for name in ids]
        places = np.array([self._place_of[key] for key in keys], dtype=np.int64)
        rows = places if self.rows is None else self.rows[places]
        in_memory = isinstance(self.store, ArrayMotions)
        return replace(
            self,
            ids=tuple(name for name, _ in keys),
            samples=tuple(sample for _, sample in keys),
            store=self.store.only(rows.tolist()) if isinstance(self.store, ArrayMotions) else self.store,
            rows=None if in_memory else rows,
        )

    @cached_property
    def _place_of(self) -> dict[tuple[str, int], int]:
        """Maps id and sample to the place; of repeated ones to the last."""
        return {key: place for place, key in enumerate(zip(self.ids, self.samples))}

    def _row(self, name: str, sample: int) -> int:
        """Return the row of a motion in the store."""
        place = self._place_of[name, sample]
        return place if self.rows is None else int(self.rows[place])

    def __contains__(self, key: tuple[str, int]) -> bool:
        return key in self._place_of

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
        joints, rays = self.store.motions(rows)
        lengths = [len(motion) for motion in joints]
        if 0 in lengths:
            i = lengths.index(0)
            raise PredictionsError(f"{self.store.where(rows[i])}, {ids[i]}: expected a motion, found no frames.")
        gaze = as_float32(np.concatenate(rays)) if rays else None
        return PredictionRows(as_float32(np.concatenate(joints)), np.concatenate(([0], np.cumsum(lengths))), gaze)
