"""Pose tables of a HOT3D recording: ``dynamic_objects.csv`` and ``headset_trajectory.csv``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int

from prbench.errors import InputFileError
from prbench.readers.files import column_vectors, read_columns, require_increasing, require_poses
from prbench.readers.hot3d import format as hot3d


def read_pose_rows(path: Path) -> dict[str, hot3d.PoseRows]:
    """Poses of every body of the file, by uid; uids stay text.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, a pose is no pose, or the clock of a body
            stands still (a repeated row) or runs backwards.
    """
    numbers = dict.fromkeys((*hot3d.POSITION, *hot3d.ROTATION), float)
    table = read_columns(path, {hot3d.OBJECT_ID: str, hot3d.TIME: int, **numbers})
    if len(table) == 0:
        raise InputFileError(
            path,
            "",
            expected="rows of poses",
            found="none",
            remedy="metadata.json says that this ground truth is there; download the recording again.",
        )
    position, rotation = column_vectors(table, hot3d.POSITION), column_vectors(table, hot3d.ROTATION)
    require_poses(path, position, rotation)
    encoded = table[hot3d.OBJECT_ID].combine_chunks().dictionary_encode()
    codes = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    times = table[hot3d.TIME].to_numpy()
    order = np.argsort(codes, kind="stable")
    _require_clock(path, codes[order], times[order], order)
    bounds = np.searchsorted(codes[order], np.arange(len(encoded.dictionary) + 1))
    return {
        uid: hot3d.PoseRows(times[rows], position[rows], rotation[rows])
        for uid, rows in zip(encoded.dictionary.to_pylist(), np.split(order, bounds[1:-1]), strict=True)
    }


def read_headset(path: Path) -> hot3d.PoseRows:
    """Poses of the glasses.

    Raises:
        InputFileError: see :func:`read_pose_rows`; or if the file holds several headsets.
    """
    rows = read_pose_rows(path)
    if len(rows) > 1:
        raise InputFileError(
            path, hot3d.OBJECT_ID, expected="one headset", found=f"{len(rows)}: {', '.join(sorted(rows)[:3])}"
        )
    return next(iter(rows.values()))


def _require_clock(
    path: Path, codes: Int[np.ndarray, " n"], times: Int[np.ndarray, " n"], order: Int[np.ndarray, " n"]
) -> None:
    """Refuse a body whose rows are not in the order of time; rows are grouped by body here."""
    backwards = np.flatnonzero((np.diff(codes) == 0) & (np.diff(times) <= 0))
    if backwards.size:
        earlier, later = backwards[0], backwards[0] + 1
        require_increasing(path, times[earlier : later + 1], unit="ns", first=int(order[later]) + 1)
