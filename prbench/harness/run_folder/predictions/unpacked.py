"""Frames of many motions in a temporary file, from which single motions are read in any order."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

_NAME = "frames.bin"


class UnpackedFrames:
    """Frames of motions, float32, after one another in a temporary file.

    The file lives as long as the object that wrote it. Copies in other processes read the same file. It is read, never
    mapped, because pages of a mapped file count as memory of the process.

    Args:
        folder: Holds the file.
        starts: First frame of each motion in the file, then the number of all frames.
        width: Numbers of one frame.
    """

    def __init__(self, folder: tempfile.TemporaryDirectory, starts: Int[np.ndarray, " _"], width: int) -> None:
        self._folder: tempfile.TemporaryDirectory | None = folder
        self._path = Path(folder.name) / _NAME
        self._starts = starts
        self._width = width

    @classmethod
    def of(cls, motions: Iterable[np.ndarray], width: int) -> UnpackedFrames:
        """Write motions, each of any number of frames of ``width`` numbers.

        Raises:
            OSError: if the temporary folder is full.
        """
        folder = tempfile.TemporaryDirectory(prefix="prbench-", ignore_cleanup_errors=True)
        starts = [0]
        with open(Path(folder.name) / _NAME, "wb") as file:
            for motion in motions:
                file.write(np.ascontiguousarray(motion, dtype=np.float32).data)
                starts.append(starts[-1] + motion.size // width)
        return cls(folder, np.array(starts, dtype=np.int64), width)

    def rows(self, rows: Sequence[int]) -> Iterator[Float[np.ndarray, "frames width"]]:
        """Read some motions, in the order given."""
        with open(self._path, "rb") as file:
            for row in rows:
                start, stop = self._starts[row : row + 2].tolist()
                file.seek(4 * self._width * start)
                yield np.fromfile(file, np.float32, self._width * (stop - start)).reshape(-1, self._width)

    def __getstate__(self) -> dict[str, Any]:
        # The temporary folder belongs to the process that made it.
        return {**self.__dict__, "_folder": None}
