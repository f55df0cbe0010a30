"""Closed-loop trajectories: poses of the glasses in one world.

Source: docs/specification/aria-mps.md#closed-loop-trajectory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from jaxtyping import Bool

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.search import NearGaze, NotSearchable, search_rows
from prbench.readers.files import (
    Column,
    RememberingTail,
    Source,
    arrow_types,
    column_vectors,
    opened,
    read_columns,
    read_header,
    require_column_names,
    require_increasing,
    require_integers,
    require_poses,
    require_whole_last_line,
    shown,
)

_NUMBERS = (*mps.POSITION_COLUMNS, *mps.ROTATION_COLUMNS, *mps.GRAVITY_COLUMNS, mps.QUALITY_COLUMN)
COLUMNS: dict[str, Column] = {mps.GRAPH_COLUMN: str, mps.TIME_COLUMN: int, **dict.fromkeys(_NUMBERS, float)}
"""Columns that are read; the velocities are unreliable and stay unread."""
_BLOCK = 2**20  # bytes


@dataclass(frozen=True)
class TrajectoryCheck:
    """Facts that hold for all rows of a sound trajectory."""

    rows: int
    first_us: int
    last_us: int
    gaps: int
    """Steps above 50 ms."""
    longest_step_us: int
    low_quality: int
    """Rows with a quality below 0.5."""
    worlds: dict[str, int]
    """Rows of each world frame; rows without a world are under ``UNDEFINED_ROW``."""


def read_trajectory(source: Source) -> mps.AriaTrajectory:
    """Read ``closed_loop_trajectory.csv`` or ADT's ``aria_trajectory.csv``.

    Rows without pose (``UNDEFINED_ROW``) and rows of another world frame than the most frequent one are left out.

    Args:
        source: The file, plain or in an archive.

    Raises:
        InputFileError: if the file is missing or empty, a column is missing, a pose is no pose, or time runs backwards.
    """
    return _trajectory_of(source, _read_whole(source))


def _trajectory_of(source: Source, table: pa.Table) -> mps.AriaTrajectory:
    """The poses of one world in a table of :data:`COLUMNS`.

    Raises:
        InputFileError: if there is none, or a pose is no pose.
    """
    rotation = column_vectors(table, mps.ROTATION_COLUMNS)
    # World frames of a trajectory, most frequent first, and the rows of the first.
    encoded = table[mps.GRAPH_COLUMN].combine_chunks().dictionary_encode()
    names = encoded.dictionary.to_pylist()
    codes = encoded.indices.to_numpy(zero_copy_only=False)
    counts = {name: int((codes == code).sum()) for code, name in enumerate(names) if name != mps.UNDEFINED_GRAPH}
    # sorted() is stable: of two equally frequent worlds the one that comes first in the file.
    ranked = tuple(sorted(counts, key=lambda name: -counts[name]))
    kept = codes == names.index(ranked[0]) if ranked else np.zeros(len(codes), dtype=bool)
    graphs, kept = ranked, kept
    require_poses(source, column_vectors(table, mps.POSITION_COLUMNS), rotation, used=kept)
    if not kept.any():
        raise InputFileError(
            shown(source),
            "",
            expected="at least one pose of the glasses",
            found="none",
            remedy="The recording has no ground truth; download it again.",
        )
    # Gravity is a constant of a world, so that the first row of the kept one tells it.
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


def _read_whole(source: Source) -> pa.Table:
    table = read_columns(source, COLUMNS)
    require_increasing(source, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    return table


def read_near(source: Source, wanted: NearGaze) -> mps.AriaTrajectory:
    """Read only the rows around wanted times, as ``format.rows_around`` would choose them from all rows.

    The rows are searched for, not read through: what stands between them is not noticed, be it a repeated row, a
    number that is none, or a world of its own shorter than the wanted steps. Rows without a world or of another one
    are left out after the choice, so that at the edge of such a stretch poses may be missing for one step of the grid;
    they are counted among the rows that were looked at. :func:`check_trajectory` looks at every row.

    Raises:
        InputFileError: as :func:`read_trajectory`, for what was looked at.
    """
    try:
        table = search_rows(source, COLUMNS, mps.TIME_COLUMN, wanted)
        require_increasing(source, table[mps.TIME_COLUMN].to_numpy(), unit="us")
        return _trajectory_of(source, table)
    except (NotSearchable, pa.ArrowInvalid, InputFileError):
        # Reading every row names the line of what is wrong.
        return _trajectory_of(source, _wanted_rows(source, _read_whole(source), wanted))


def _wanted_rows(source: Source, table: pa.Table, wanted: NearGaze) -> pa.Table:
    if len(table) == 0:
        return table
    rotation, position = (column_vectors(table, names) for names in (mps.ROTATION_COLUMNS, mps.POSITION_COLUMNS))
    rows = wanted.rows(table[mps.TIME_COLUMN].to_numpy())
    # Looked at before the choice, so that a bad pose is named by its line in the file.
    require_poses(source, position, rotation, used=np.isin(np.arange(len(table)), rows) & _has_world(table))
    return table.take(rows)


def _has_world(table: pa.Table) -> Bool[np.ndarray, " n"]:
    """Rows that hold a pose at all."""
    undefined = pc.call_function("equal", [table[mps.GRAPH_COLUMN], pa.scalar(mps.UNDEFINED_GRAPH)])
    return ~undefined.to_numpy(zero_copy_only=False)


@foreign_input()
def check_trajectory(source: Source) -> TrajectoryCheck:
    """Look at every row: what a searching read cannot notice shows here.

    Raises:
        InputFileError: if the file is missing or empty, a column is missing, a line is cut or holds no numbers, a pose
            is no pose, or time does not increase; naming the line.
    """
    worlds: Counter[str] = Counter()
    first_us = last_us = None
    rows = low_quality = gaps = longest = 0
    with opened(source) as file:
        stream = RememberingTail(file)
        for table in _tables(source, stream):
            time_us = table[mps.TIME_COLUMN].to_numpy()
            # The last time of the block before joins in: the step between two blocks counts, too.
            known = time_us if last_us is None else np.append(last_us, time_us)
            require_increasing(source, known, unit="us", first=rows + 2 - (last_us is not None))
            _require_poses(source, table, first=rows + 2)
            steps = np.diff(known)
            gaps += int((steps > mps.LONGEST_POSE_STEP * 1e6).sum())
            longest = max(longest, int(steps.max(initial=0)))
            low_quality += int((table[mps.QUALITY_COLUMN].to_numpy() < mps.LEAST_QUALITY).sum())
            counts = table[mps.GRAPH_COLUMN].value_counts()
            worlds.update(
                dict(zip(counts.field("values").to_pylist(), counts.field("counts").to_pylist(), strict=True))
            )
            first_us = time_us[0] if first_us is None else first_us
            last_us = time_us[-1]
            rows += len(table)
    require_whole_last_line(shown(source), COLUMNS, read_header(source), tail=stream.tail)
    if first_us is None or last_us is None:
        raise InputFileError(shown(source), "", expected="poses of the glasses", found="none")
    return TrajectoryCheck(rows, int(first_us), int(last_us), gaps, longest, low_quality, dict(worlds))


def _tables(source: Source, stream: RememberingTail) -> Iterator[pa.Table]:
    require_column_names(source, read_header(source), COLUMNS)
    convert = pyarrow.csv.ConvertOptions(column_types=arrow_types(COLUMNS), include_columns=list(COLUMNS))
    read = pyarrow.csv.ReadOptions(block_size=_BLOCK, use_threads=False)
    try:
        for batch in pyarrow.csv.open_csv(stream, read_options=read, convert_options=convert):
            if len(batch):
                table = pa.Table.from_batches([batch])
                require_integers(source, table, COLUMNS)
                yield table
    except pa.ArrowInvalid:
        read_columns(source, COLUMNS)  # names the line
        raise


def _require_poses(source: Source, table: pa.Table, *, first: int) -> None:
    position, rotation = (column_vectors(table, names) for names in (mps.POSITION_COLUMNS, mps.ROTATION_COLUMNS))
    require_poses(source, position, rotation, used=_has_world(table), first=first)
