"""Poses of the HoloLens and of the suit's head, each on its own clock (docs/specification/gimo.md#hololens)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.bounded import require, require_rows
from prbench.geometry.skeleton import Joint
from prbench.readers.files import opened
from prbench.readers.gimo.bvh import joints_in_metres, read_bvh
from prbench.readers.gimo.format import SKELETON_FILE
from prbench.recording import PoseStream

_PATTERN = "*_head_hand_eye.csv"
_TICKS = 1e7  # a second
# The file has no header: a time, a pose of 4 x 4 numbers row by row, and 844 numbers of hands and gaze.
_COLUMNS = [f"f{column}" for column in range(17)]


def read_hololens(path: Path) -> PoseStream:
    """Read the poses of the head in the HoloLens' world, metres, seconds on its own clock.

    Raises:
        InputFileError: for a damaged file, and for poses that are none.
    """
    reading = pyarrow.csv.ReadOptions(autogenerate_column_names=True)
    wanted = pyarrow.csv.ConvertOptions(include_columns=_COLUMNS, column_types=dict.fromkeys(_COLUMNS, pa.float64()))
    try:
        with opened(path) as file:
            table = pyarrow.csv.read_csv(file, read_options=reading, convert_options=wanted)
    except (pa.ArrowInvalid, pa.ArrowKeyError) as error:
        found = str(error).splitlines()[0][:160]
        raise InputFileError(path, "", expected="lines of a time and 16 or more numbers", found=found) from error
    values = np.stack([column.to_numpy() for column in table.columns], axis=1)
    poses = values[:, 1:].reshape(-1, 4, 4)
    turns = poses[:, :3, :3]
    rigid = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < 1e-2
    wrong = ~(np.isfinite(values).all(axis=1) & rigid & (np.linalg.det(turns) > 0.0))
    require_rows(path, wrong, "a pose of 4 x 4 numbers", "no rotation", place="line", first=1)
    later = np.flatnonzero(np.diff(values[:, 0], prepend=-np.inf) > 0)
    expected = "two or more times that increase"
    require(path, (len(later) > 1, "", expected, f"{len(later)}", "Copy or download the file again."))
    rotation = Rotation.from_matrix(turns[later]).as_quat(scalar_first=True)
    valid = np.ones(len(later), dtype=bool)
    return PoseStream((values[later, 0] - values[0, 0]) / _TICKS, poses[later, :3, 3], rotation, valid)


def hololens_and_suit(folder: Path) -> tuple[PoseStream, PoseStream]:
    """Read the HoloLens' and the suit's head of one sequence; worlds and clocks differ.

    Raises:
        InputFileError: if one of the files is missing or damaged.
    """
    named = sorted(folder.glob(_PATTERN))
    remedy = "Download it: the poses of the HoloLens are in no other file."
    require(folder, (bool(named), _PATTERN, "a recording of the HoloLens", "no such file", remedy))
    motion = read_bvh(folder / SKELETON_FILE)
    joints, turned = joints_in_metres(motion, folder / SKELETON_FILE)
    times = np.arange(len(joints)) * motion.frame_time
    valid = np.ones(len(times), dtype=bool)
    suit = PoseStream(times, joints[:, Joint.HEAD], turned.as_quat(scalar_first=True), valid)
    return read_hololens(named[0]), suit
