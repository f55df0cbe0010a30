"""Gaze of an ADT recording: the shared files of the services, and a look at their unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.aria_mps import read_gaze_angles
from prbench.readers.aria_mps.format import GazeAngles

_BEHIND = np.pi / 2  # radians; no eye looks there
_TOO_MANY = 0.2  # share of rows


def read_gaze(path: Path) -> GazeAngles:
    """Read a gaze file and refuse angles that are no radians.

    Raises:
        InputFileError: as :func:`prbench.readers.aria_mps.read_gaze_angles`; or if many angles would look backwards.
    """
    gaze = read_gaze_angles(path)
    largest = np.maximum(np.abs(gaze.yaw), np.abs(gaze.pitch))
    known = largest[np.isfinite(largest)]
    if len(known) and (known > _BEHIND).mean() > _TOO_MANY:
        raise InputFileError(
            path,
            "yaw and pitch",
            expected="angles in radians, below 1.57",
            found=f"angles up to {known.max():.1f} in {int((known > _BEHIND).sum())} of {len(known)} rows",
            remedy="They look like degrees; use the file as it was released.",
        )
    return gaze
