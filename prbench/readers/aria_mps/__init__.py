"""Files of the Aria Machine Perception Services, shared by the Aria datasets (docs/specification/aria-mps.md).

A dataset's ``find`` adds :func:`find_mps_files` to a recording's files; its ``read`` calls :func:`read_mps` and gives
what comes back to :func:`prbench.readers.aria_mps.to_recording.mps_streams`.
"""

from __future__ import annotations

from prbench.readers.aria_mps.find import UNREADABLE, find_gaze_file, find_mps_files
from prbench.readers.aria_mps.format import AriaTrajectory
from prbench.readers.aria_mps.readings import (
    OnlineCalibration,
    read_first_calibration,
    read_gaze_angles,
    read_hand_tracking,
    read_mps,
    read_wrists,
)
from prbench.readers.aria_mps.trajectory import TrajectoryCheck, check_trajectory, read_trajectory
from prbench.readers.zipped import Source, ZippedFile, source_of

__all__ = [
    "UNREADABLE",
    "AriaTrajectory",
    "OnlineCalibration",
    "Source",
    "TrajectoryCheck",
    "ZippedFile",
    "check_trajectory",
    "find_gaze_file",
    "find_mps_files",
    "read_first_calibration",
    "read_gaze_angles",
    "read_hand_tracking",
    "read_mps",
    "read_trajectory",
    "read_wrists",
    "source_of",
]
