"""Eye gaze files of the Machine Perception Services, three schemas (docs/specification/aria-mps.md#eye-gaze)."""

from __future__ import annotations

import numpy as np

from prbench.errors import InputFileError
from prbench.limits import FARTHEST_POSITION, LARGEST_ANGLE
from prbench.ranges import require_column
from prbench.readers.aria_mps import format as mps
from prbench.readers.files import read_columns, read_header, require_increasing
from prbench.readers.zipped import Source, shown

_LIKE_DEGREES = "Such angles look like degrees, or are damaged; use the file as it was released."


def read_gaze_angles(path: Source) -> mps.GazeAngles:
    """Read one gaze file of any of the three schemas, told apart by columns (docs/specification/aria-mps.md#eye-gaze).

    Two yaws (schema B) become one; bounds that a schema lacks are NaN, and so is a missing depth.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, or time runs backwards.
    """
    names = read_header(path)
    two_eyes = mps.YAW not in names and mps.LEFT_YAW in names
    yaws = (mps.LEFT_YAW, mps.RIGHT_YAW) if two_eyes else (mps.YAW,)
    optional = (
        *mps.YAW_RANGE,
        *mps.LEFT_YAW_RANGE,
        *mps.RIGHT_YAW_RANGE,
        *mps.PITCH_RANGE,
        mps.DEPTH,
    )
    wanted = (*yaws, mps.PITCH, *(name for name in optional if name in names))
    table = read_columns(path, {mps.TIME_COLUMN: int, **dict.fromkeys(wanted, float)})
    if len(table) == 0:
        raise InputFileError(
            shown(path),
            "",
            expected="gaze rows",
            found="none",
            remedy="Without gaze nothing is primed; download it again.",
        )
    require_increasing(path, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    for name in (*yaws, mps.PITCH):  # their bounds steer no ray
        require_column(shown(path), name, columns[name], largest=LARGEST_ANGLE, unit="rad", remedy=_LIKE_DEGREES)
    if mps.DEPTH in columns:
        require_column(shown(path), mps.DEPTH, columns[mps.DEPTH], largest=FARTHEST_POSITION, unit="m")
    unknown = np.full(len(table), np.nan)

    def pair(names: tuple[str, str]) -> np.ndarray:
        return np.column_stack([columns.get(name, unknown) for name in names])

    yaw = mps.combined_yaw(columns[mps.LEFT_YAW], columns[mps.RIGHT_YAW]) if two_eyes else columns[mps.YAW]
    yaw_range = (
        mps.combined_yaw(pair(mps.LEFT_YAW_RANGE), pair(mps.RIGHT_YAW_RANGE)) if two_eyes else pair(mps.YAW_RANGE)
    )
    return mps.GazeAngles(
        columns[mps.TIME_COLUMN],
        yaw,
        columns[mps.PITCH],
        columns.get(mps.DEPTH, unknown),
        yaw_range,
        pair(mps.PITCH_RANGE),
    )
