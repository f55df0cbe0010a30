"""BVH: the hierarchy of the 22 joints and its rotations, Y up, degrees."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import PARENTS, Joint
from prbench.readers.gimo.bvh import POSITION_CHANNELS, BvhJoint, BvhMotion, write_bvh
from prbench.viewing.exporting.skeleton import NESTED_ORDER, PosedSkeleton

# BVH names no unit; tools expect one of these. Values are file units a metre.
UNITS = {"m": 1.0, "cm": 100.0}
# The middle angle of these is a bend forwards or a roll of the arm, which seldom reach the quarter turn at which the
# other two lose their meaning; a heading does.
_ORDER = "ZXY"
_TIP = 0.1  # metres


def write_motion_bvh(posed: PosedSkeleton, path: Path, *, fps: float, unit: str) -> None:
    """Write a motion as BVH.

    Args:
        posed: The motion.
        path: The file.
        fps: Frames a second.
        unit: One of :data:`UNITS`.
    """
    scale = UNITS[unit]
    rotations = tuple(f"{axis}rotation" for axis in _ORDER)
    joints = []
    columns = [posed.root * scale]
    for joint in NESTED_ORDER:
        parent = NESTED_ORDER.index(PARENTS[joint]) if joint else -1
        offset = posed.offsets[joint] * scale if joint else np.zeros(3)
        channels = rotations if joint else (*POSITION_CHANNELS, *rotations)
        x, y, z = offset.round(8).tolist()
        joints.append(BvhJoint(Joint(joint).name.lower(), parent, (x, y, z), channels))
        with warnings.catch_warnings():  # of a quarter turn, where any of the equal triples will do
            warnings.simplefilter("ignore", UserWarning)
            angles = Rotation.from_matrix(posed.local[:, joint]).as_euler(_ORDER, degrees=True)
        columns.append(np.unwrap(angles, period=360.0, axis=0))  # tools that draw between frames turn the short way
    motion = BvhMotion(tuple(joints), 1.0 / fps, np.concatenate(columns, axis=1))
    write_bvh(motion, path, tip=_TIP * scale)
