"""Hand files of the Machine Perception Services: wrists and palms in the device frame.

Source: docs/specification/aria-mps.md#hands.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyarrow as pa

from prbench.readers.aria_mps import format as mps
from prbench.readers.files import column_vectors, read_columns, require_increasing
from prbench.readers.zipped import Source

_Columns = Callable[[str], tuple[str, ...]]


def read_wrists(path: Source) -> mps.WristPositions:
    """Read ``wrist_and_palm_poses.csv``, old or new.

    A hand counts as seen where its confidence is above 0 and its wrist is a number; where it was not, other columns
    may say -1 or 0.

    Raises:
        InputFileError: if the file or a column is missing, time runs backwards.
    """
    return _read(path, lambda side: _axes(f"{side}_wrist_device"), lambda side: _axes(f"{side}_palm_device"))


def read_hand_tracking(path: Source) -> mps.WristPositions:
    """Read wrists and palms of ``hand_tracking_results.csv``: landmarks 5 and 20 of 21.

    Raises:
        InputFileError: as :func:`read_wrists`.
    """
    return _read(
        path,
        lambda side: _axes(f"{side}_landmark_{mps.WRIST_LANDMARK}_device"),
        lambda side: _axes(f"{side}_landmark_{mps.PALM_LANDMARK}_device"),
    )


def _axes(name: str) -> tuple[str, ...]:
    return tuple(f"t{axis}_{name}" for axis in "xyz")


def _read(path: Source, wrist: _Columns, palm: _Columns) -> mps.WristPositions:
    confidences = tuple(f"{side}_tracking_confidence" for side in mps.SIDES)
    numbers = (*confidences, *(name for side in mps.SIDES for name in (*wrist(side), *palm(side))))
    table = read_columns(path, {mps.TIME_COLUMN: int, **dict.fromkeys(numbers, float)})
    time_us = table[mps.TIME_COLUMN].to_numpy()
    require_increasing(path, time_us, unit="us")
    wrists, palms = _points(table, wrist), _points(table, palm)
    confidence = np.nan_to_num(column_vectors(table, confidences), nan=0.0)
    seen = (confidence > 0) & np.isfinite(wrists).all(axis=2)
    return mps.WristPositions(
        time_us,
        np.where(seen, confidence, np.minimum(confidence, 0.0)),
        np.where(seen[..., None], wrists, np.nan),
        np.where(seen[..., None], palms, np.nan),
    )


def _points(table: pa.Table, columns: _Columns) -> np.ndarray:
    return np.stack([column_vectors(table, columns(side)) for side in mps.SIDES], axis=1)
