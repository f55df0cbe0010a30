"""Numbers of recordings that cannot be what their fields mean, refused with stream, row and value; and repeated ids."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import InputFileError, RecordingUnusable
from prbench.limits import LATEST_TIME, LONGEST_RECORDING

_REMEDY = "A number of its files is damaged, or in another unit; compare them with another copy."
_LENGTH_TOLERANCE = 0.01


def require_times(stream: str, times: Float[np.ndarray, " n"]) -> None:
    """Refuse clocks that no recording has.

    Args:
        stream: What the times are of, for the message.
        times: Seconds.

    Raises:
        RecordingUnusable: naming the first row beyond :data:`prbench.limits.LATEST_TIME`, or the two ends of a stream
            that is longer than :data:`prbench.limits.LONGEST_RECORDING`.
    """
    beyond = np.abs(times) > LATEST_TIME
    if beyond.any():
        row = int(np.argmax(beyond))
        raise _unusable(stream, row, f"a time within {LATEST_TIME:.0e} s", f"{times[row]:g} s")
    if len(times) and np.ptp(times) > LONGEST_RECORDING:
        raise RecordingUnusable(
            f"{stream}: expected at most {LONGEST_RECORDING:,.0f} s from first to last, found {times.min():.1f} …"
            f" {times.max():.1f} s. {_REMEDY}"
        )


def require_near(
    stream: str, points: Float[np.ndarray, "n ..."], valid: Bool[np.ndarray, " n"] | None = None, *, farthest: float
) -> None:
    """Refuse points that lie farther from the origin than anything can.

    Args:
        stream: What the points are of, for the message.
        points: One or more points a row, metres.
        valid: Rows that matter; all by default.
        farthest: Largest coordinate, metres.

    Raises:
        RecordingUnusable: naming the first such row and its value.
    """
    if points.size == 0:
        return
    beyond = np.abs(points.reshape(len(points), -1)) > farthest
    if valid is not None:
        beyond &= valid[:, None]
    if beyond.any():
        row = int(np.argmax(beyond.any(axis=1)))
        found = points[row].reshape(-1)[int(np.argmax(beyond[row]))]
        raise _unusable(stream, row, f"a position within {farthest:,.0f} m of the origin", f"{found:g} m")


def require_unit_length(stream: str, vectors: Float[np.ndarray, "n k"], valid: Bool[np.ndarray, " n"]) -> None:
    """Refuse directions and quaternions whose length is not 1.

    Raises:
        RecordingUnusable: naming the first such row and its length.
    """
    length = np.sqrt(np.einsum("nk,nk->n", vectors, vectors, dtype=np.float64))
    wrong = valid & (np.abs(length - 1) > _LENGTH_TOLERANCE)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise _unusable(stream, row, "a vector of length 1", f"length {length[row]:g}")


def require_column(
    path: Path | str,
    column: str,
    values: Float[np.ndarray, " n"],
    *,
    largest: float,
    unit: str,
    remedy: str = _REMEDY,
) -> None:
    """Refuse a column of a table file that holds a number beyond what its field can mean; NaN may stand in it.

    Args:
        path: The file, whose first row of numbers is its second line.
        column: Name of the column.
        values: Its numbers.
        largest: Largest number without sign.
        unit: Of the numbers, for the message.
        remedy: What to do about a larger one.

    Raises:
        InputFileError: naming line and column of the first such number.
    """
    beyond = np.abs(values) > largest
    if beyond.any():
        row = int(np.argmax(beyond))
        raise InputFileError(
            path,
            f"line {row + 2}, column '{column}'",
            expected=f"a number within {largest:g} {unit}",
            found=f"{values[row]:g}",
            remedy=remedy,
        )


def first_repeated(ids: Iterable[str]) -> str | None:
    """Return the first id that has stood before, or None if all are different."""
    seen = set[str]()
    for name in ids:
        if name in seen:
            return name
        seen.add(name)
    return None


def _unusable(stream: str, row: int, expected: str, found: str) -> RecordingUnusable:
    return RecordingUnusable(f"{stream}, row {row}: expected {expected}, found {found}. {_REMEDY}")
