"""Tables of poses with one row a body and instant, as Aria Digital Twin and HOT3D hold them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.readers.files import Column, column_vectors, read_columns, require_increasing, require_poses

Poses = tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]
"""Times, positions and rotations of one body."""


def read_poses_by_body(
    path: Path,
    *,
    body: Mapping[str, Column],
    time: str,
    position: tuple[str, ...],
    rotation: tuple[str, ...],
    static_time: int | None = None,
) -> dict[Any, Poses]:
    """Poses of every body of a file, each in the order of time.

    Args:
        path: CSV with a header line.
        body: Name and type of the column that tells the body.
        time: Name of the column of times, integers in nanoseconds.
        position: Names of its three columns.
        rotation: Names of its four columns.
        static_time: Stands for a time in the only row of a body that never moves.

    Raises:
        InputFileError: if the file or a column is missing, a pose is no pose, or the clock of a body stands still (a
            repeated row) or runs backwards.
    """
    (key,) = body
    table = read_columns(path, {**body, time: int, **dict.fromkeys((*position, *rotation), float)})
    positions = column_vectors(table, position)
    rotations = column_vectors(table, rotation)
    require_poses(path, positions, rotations)
    encoded = table[key].combine_chunks().dictionary_encode()
    codes = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    times = table[time].to_numpy()
    # Sorted by body alone: rows of one body keep the order of the file, which must be that of time.
    order = np.argsort(codes, kind="stable")
    _require_clock(path, codes[order], times[order], order, static_time)
    bounds = np.searchsorted(codes[order], np.arange(1, len(encoded.dictionary)))
    bodies = zip(encoded.dictionary.to_pylist(), np.split(order, bounds), strict=True) if len(table) else ()
    return {name: (times[rows], positions[rows], rotations[rows]) for name, rows in bodies}


def _require_clock(
    path: Path,
    codes: Int[np.ndarray, " n"],
    times: Int[np.ndarray, " n"],
    order: Int[np.ndarray, " n"],
    static_time: int | None,
) -> None:
    """Refuse a body whose rows are not in the order of time; rows are grouped by body here."""
    same_body = np.diff(codes) == 0
    mixed = np.flatnonzero(same_body & ((times[:-1] == static_time) | (times[1:] == static_time)))
    if mixed.size:
        raise InputFileError(
            path,
            f"line {int(order[mixed[0] + 1]) + 2}",
            expected=f"one row of time {static_time} for an object that never moves, or rows with times",
            found=f"both, or two rows of time {static_time}, for one object",
            remedy="Remove one of the rows, or download the file again.",
        )
    backwards = np.flatnonzero(same_body & (np.diff(times) <= 0))
    if backwards.size:
        earlier = backwards[0]
        later = backwards[0] + 1
        require_increasing(path, times[earlier : later + 1], unit="ns", first=int(order[later]) + 1)
