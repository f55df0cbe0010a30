"""Closed-loop trajectories: poses of the glasses in one world (section 3)."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.errors import InputFileError
from prbench.formats import aria_mps as mps
from prbench.readers.files import Column, column_vectors, read_columns, require_increasing, require_poses
from prbench.readers.zipped import Source, shown

NUMBERS = (*mps.POSITION_COLUMNS, *mps.ROTATION_COLUMNS, *mps.GRAVITY_COLUMNS, mps.QUALITY_COLUMN)
COLUMNS: dict[str, Column] = {mps.GRAPH_COLUMN: str, mps.TIME_COLUMN: int, **dict.fromkeys(NUMBERS, float)}
"""What is read; the velocities are unreliable and stay unread."""


def read_trajectory(source: Source, *, near_us: Int[np.ndarray, " m"] | None = None) -> mps.AriaTrajectory:
    """Read ``closed_loop_trajectory.csv`` or ADT's ``aria_trajectory.csv``.

    Rows without pose (``UNDEFINED_ROW``) and rows of another world frame than the most frequent one are left out.

    Args:
        source: The file, plain or in an archive.
        near_us: Keep the rows on both sides of these times only (:func:`prbench.formats.aria_mps.rows_around`); all
            rows if None.

    Raises:
        InputFileError: if the file is missing or empty, a column is missing, a pose is no pose, or time runs backwards.
    """
    table = read_columns(source, COLUMNS)
    require_increasing(source, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    if near_us is not None and len(table):
        table = table.take(mps.rows_around(table[mps.TIME_COLUMN].to_numpy(), near_us))
    return trajectory_of(source, table)


def trajectory_of(source: Source, table: pa.Table) -> mps.AriaTrajectory:
    """The poses of one world in a table of :data:`COLUMNS`.

    Raises:
        InputFileError: if there is none, or a pose is no pose.
    """
    rotation = column_vectors(table, mps.ROTATION_COLUMNS)
    graphs, kept = _one_world(table)
    require_poses(source, column_vectors(table, mps.POSITION_COLUMNS), rotation, used=kept)
    if not kept.any():
        raise InputFileError(
            shown(source),
            "",
            expected="at least one pose of the glasses",
            found="none",
            remedy="The recording has no ground truth; download it again.",
        )
    gravity = column_vectors(table, mps.GRAVITY_COLUMNS)[kept][0]
    return mps.AriaTrajectory(
        time_us=table[mps.TIME_COLUMN].to_numpy()[kept],
        position=column_vectors(table, mps.POSITION_COLUMNS)[kept],
        rotation=rotation[kept],
        quality=table[mps.QUALITY_COLUMN].to_numpy()[kept],
        up=-gravity / np.linalg.norm(gravity),
        graph_uids=graphs,
        left_out=int((~kept).sum()),
    )


def _one_world(table: pa.Table) -> tuple[tuple[str, ...], np.ndarray]:
    """World frames of a trajectory, most frequent first, and the rows of the first."""
    encoded = table[mps.GRAPH_COLUMN].combine_chunks().dictionary_encode()
    names, codes = encoded.dictionary.to_pylist(), encoded.indices.to_numpy(zero_copy_only=False)
    counts = {name: int((codes == code).sum()) for code, name in enumerate(names) if name != mps.UNDEFINED_GRAPH}
    ranked = tuple(sorted(counts, key=lambda name: -counts[name]))
    kept = codes == names.index(ranked[0]) if ranked else np.zeros(len(codes), dtype=bool)
    return ranked, kept
