"""A look at every row of a trajectory, in memory that does not grow with it (for ``prbench inspect``)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.csv

from prbench.boundary import foreign_input
from prbench.errors import InputFileError
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.trajectory import COLUMNS, has_world
from prbench.readers.files import (
    arrow_types,
    column_vectors,
    read_columns,
    read_header,
    require_column_names,
    require_increasing,
    require_integers,
    require_poses,
)
from prbench.readers.last_line import require_whole_last_line
from prbench.readers.zipped import RememberingTail, Source, opened, shown

_BLOCK = 2**20  # bytes


@dataclass(frozen=True)
class TrajectoryCheck:
    """What all rows of a sound trajectory say."""

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
            first_us, last_us = time_us[0] if first_us is None else first_us, time_us[-1]
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
    require_poses(source, position, rotation, used=has_world(table), first=first)
