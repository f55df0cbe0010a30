"""Closed-loop trajectories: poses of the glasses in one world.

Source: docs/specification/aria-mps.md#closed-loop-trajectory.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Int

from prbench.files.bounded import foreign_input, require
from prbench.readers.aria_mps import format as mps
from prbench.readers.files import (
    Column,
    Source,
    column_vectors,
    read_blocks,
    read_columns,
    require_increasing,
    require_poses,
    shown,
)

_NUMBERS = (*mps.POSITION_COLUMNS, *mps.ROTATION_COLUMNS, *mps.GRAVITY_COLUMNS, mps.QUALITY_COLUMN)
# Columns that are read; the velocities are unreliable and stay unread.
COLUMNS: dict[str, Column] = {mps.GRAPH_COLUMN: str, mps.TIME_COLUMN: int, **dict.fromkeys(_NUMBERS, float)}


def read_trajectory(source: Source) -> mps.AriaTrajectory:
    """Read ``closed_loop_trajectory.csv`` or ADT's ``aria_trajectory.csv``.

    Rows without pose (``UNDEFINED_ROW``) and rows of another world frame than the most frequent one are left out.

    Args:
        source: The file, plain or in an archive.

    Raises:
        InputFileError: if the file is missing or empty, a column is missing, a pose is no pose, or time runs backwards.
    """
    table = read_columns(source, COLUMNS)
    require_increasing(source, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    return _trajectory_of(source, table)


@foreign_input()
def read_near(source: Source, gaze_us: Int[np.ndarray, " n"], rate: float = mps.POSE_RATE) -> mps.AriaTrajectory:
    """Check every row, and keep those around the gaze times and a regular grid, as :func:`mps.thinned` chooses them.

    Rows without a world or of another one are left out after the choice, so that at the edge of such a stretch poses
    may be missing for one step of the grid. Memory holds a block of text and the rows that are kept.

    Args:
        source: The file, plain or in an archive.
        gaze_us: Gaze times, increasing, microseconds on the device clock.
        rate: Rate of the grid, Hz.

    Raises:
        InputFileError: as :func:`read_trajectory`.
    """
    kept: list[pa.Table] = []
    last = first_us = None
    rows = 0
    for table in read_blocks(source, COLUMNS):
        if not len(table):
            continue
        # The last row of the block before joins in: it may lie before a wanted time of this block.
        known = table if last is None else pa.concat_tables([last, table])
        time_us = known[mps.TIME_COLUMN].to_numpy()
        line = rows + 2 - (last is not None)
        require_increasing(source, time_us, unit="us", first=line)
        has_world = pc.call_function("not_equal", [known[mps.GRAPH_COLUMN], pa.scalar(mps.UNDEFINED_GRAPH)])
        position, rotation = (column_vectors(known, names) for names in (mps.POSITION_COLUMNS, mps.ROTATION_COLUMNS))
        require_poses(source, position, rotation, used=has_world.to_numpy(zero_copy_only=False), first=line)
        first_us = int(time_us[0]) if first_us is None else first_us
        wanted = mps.wanted_times_us(gaze_us, first_us, int(time_us[-1]), rate, from_us=int(time_us[0]))
        kept.append(known.take(mps.rows_around(time_us, wanted[wanted <= time_us[-1]])))
        last = known.slice(len(known) - 1)
        rows += len(table)
    if last is None:
        return read_trajectory(source)
    # The grid reaches beyond the last row, which therefore counts; a row that two blocks have stands twice.
    table = pa.concat_tables([*kept, last])
    time_us = table[mps.TIME_COLUMN].to_numpy()
    return _trajectory_of(source, table.filter(pa.array(np.diff(time_us, prepend=time_us[0] - 1) > 0)))


def _trajectory_of(source: Source, table: pa.Table) -> mps.AriaTrajectory:
    """Return the poses of one world in a table of :data:`COLUMNS`.

    Raises:
        InputFileError: if there is none, or a pose is no pose.
    """
    position, rotation, gravity = (
        column_vectors(table, names) for names in (mps.POSITION_COLUMNS, mps.ROTATION_COLUMNS, mps.GRAVITY_COLUMNS)
    )
    # World frames of a trajectory, most frequent first, and the rows of the first.
    encoded = table[mps.GRAPH_COLUMN].combine_chunks().dictionary_encode()
    names = encoded.dictionary.to_pylist()
    codes = encoded.indices.to_numpy(zero_copy_only=False)
    counts = {name: int((codes == code).sum()) for code, name in enumerate(names) if name != mps.UNDEFINED_GRAPH}
    # sorted() is stable: of two equally frequent worlds the one that comes first in the file.
    graphs = tuple(sorted(counts, key=lambda name: -counts[name]))
    kept = codes == names.index(graphs[0]) if graphs else np.zeros(len(codes), dtype=bool)
    require_poses(source, position, rotation, used=kept)
    expected = "at least one pose of the glasses"
    require(shown(source), (kept.any(), "", expected, "none", "The recording has no ground truth; download it again."))
    # Gravity is a constant of a world, so that the first row of the kept one tells it.
    down = gravity[kept][0]
    return mps.AriaTrajectory(
        time_us=table[mps.TIME_COLUMN].to_numpy()[kept],
        position=position[kept],
        rotation=rotation[kept],
        quality=table[mps.QUALITY_COLUMN].to_numpy()[kept],
        up=-down / np.linalg.norm(down),
        graph_uids=graphs,
        left_out=int((~kept).sum()),
    )
