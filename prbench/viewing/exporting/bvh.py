"""BVH: the hierarchy of the 22 joints and its rotations, Y up, degrees."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import PARENTS, Joint
from prbench.readers.gimo.bvh import POSITION_CHANNELS, BvhJoint, BvhMotion, write_bvh
from prbench.viewing.exporting.skeleton import NESTED_ORDER, pose_skeleton
from prbench.viewing.replay.scene import Scene

if TYPE_CHECKING:
    from prbench.viewing.exporting.export import ExportRequest

# BVH names no unit; tools expect one of these. Values are file units a metre.
UNITS = {"m": 1.0, "cm": 100.0}
# The middle angle of these is a bend forwards or a roll of the arm, which seldom reach the quarter turn at which the
# other two lose their meaning; a heading does.
_ORDER = "ZXY"
_TIP = 0.1  # metres


def write(scene: Scene, path: Path, about: Mapping[str, Any], request: ExportRequest) -> Float[np.ndarray, "n 22"]:  # noqa: ARG001
    """Write the first motion of a scene; BVH has no place for what is said of it.

    Returns:
        Distance of each joint in the file from the motion, metres.
    """
    posed = pose_skeleton(scene.motions[0].joints)
    scale = UNITS[request.unit]
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
    write_bvh(BvhMotion(tuple(joints), 1.0 / scene.fps, np.concatenate(columns, axis=1)), path, tip=_TIP * scale)
    return posed.error
