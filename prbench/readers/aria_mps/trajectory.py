"""Closed-loop trajectories: poses of the glasses in one world.

Source: docs/specification/aria-mps.md#closed-loop-trajectory.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Int

from prbench.errors import InputFileError
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.kept import keep_trajectory, load_trajectory
from prbench.readers.aria_mps.line_search import NotSearchable
from prbench.readers.aria_mps.sparse_rows import search_rows
from prbench.readers.aria_mps.wanted import NearTimes, Wanted
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
        near_us: Keep the rows on both sides of these times only
            (:func:`prbench.readers.aria_mps.format.rows_around`); all rows if None.

    Raises:
        InputFileError: if the file is missing or empty, a column is missing, a pose is no pose, or time runs backwards.
    """
    return _read_whole(source) if near_us is None else read_near(source, NearTimes(near_us))


def read_near(source: Source, wanted: Wanted) -> mps.AriaTrajectory:
    """Read only the rows around wanted times, as ``rows_around`` would choose them from all rows.

    The rows are searched for, not read through: what stands between them is not noticed, be it a repeated row, a
    number that is none, or a world of its own shorter than the wanted steps. Rows without a world or of another one
    are left out after the choice, so that at the edge of such a stretch poses may be missing for one step of the grid;
    they are counted among the rows that were looked at. :func:`prbench.readers.aria_mps.check_trajectory` looks at
    every row. What was read is kept for the next time (:mod:`prbench.readers.parse_cache`).

    Raises:
        InputFileError: as :func:`read_trajectory`, for what was looked at.
    """
    kept = load_trajectory(source, wanted.key())
    if kept is not None:
        return kept
    try:
        table = search_rows(source, COLUMNS, mps.TIME_COLUMN, wanted)
        require_increasing(source, table[mps.TIME_COLUMN].to_numpy(), unit="us")
        trajectory = trajectory_of(source, table)
    except (NotSearchable, pa.ArrowInvalid, InputFileError):
        trajectory = _read_whole(source, wanted)  # it names the line of what is wrong
    keep_trajectory(source, wanted.key(), trajectory)
    return trajectory


def _read_whole(source: Source, wanted: Wanted | None = None) -> mps.AriaTrajectory:
    table = read_columns(source, COLUMNS)
    time_us = table[mps.TIME_COLUMN].to_numpy()
    require_increasing(source, time_us, unit="us")
    if wanted is None or len(table) == 0:
        return trajectory_of(source, table)
    rotation, position = (column_vectors(table, names) for names in (mps.ROTATION_COLUMNS, mps.POSITION_COLUMNS))
    rows = wanted.rows(time_us)
    require_poses(source, position, rotation, used=np.isin(np.arange(len(table)), rows) & has_world(table))
    return trajectory_of(source, table.take(rows))


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


def has_world(table: pa.Table) -> Bool[np.ndarray, " n"]:
    """Rows that hold a pose at all."""
    undefined = pc.call_function("equal", [table[mps.GRAPH_COLUMN], pa.scalar(mps.UNDEFINED_GRAPH)])
    return ~undefined.to_numpy(zero_copy_only=False)


def _one_world(table: pa.Table) -> tuple[tuple[str, ...], np.ndarray]:
    """World frames of a trajectory, most frequent first, and the rows of the first."""
    encoded = table[mps.GRAPH_COLUMN].combine_chunks().dictionary_encode()
    names, codes = encoded.dictionary.to_pylist(), encoded.indices.to_numpy(zero_copy_only=False)
    counts = {name: int((codes == code).sum()) for code, name in enumerate(names) if name != mps.UNDEFINED_GRAPH}
    ranked = tuple(sorted(counts, key=lambda name: -counts[name]))
    kept = codes == names.index(ranked[0]) if ranked else np.zeros(len(codes), dtype=bool)
    return ranked, kept
