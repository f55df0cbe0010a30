"""Route A: exact joints from the fitted parameters, with VPoser v1 and SMPL-X neutral.

Source: docs/specification/gimo.md#three-routes-to-the-22-joints.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.readers.egoallo.format import forward_kinematics
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.body_model import PoseDecoder, SmplxModel


def joints_from_parameters(poses: gimo.SmplxPoses, decoder: PoseDecoder, model: SmplxModel) -> gimo.LocalJoints:
    """The 22 joints of every frame that has parameters; the pelvis is at ``trans`` plus the model's own rest pelvis."""
    rest = model.rest_joints
    local = Rotation.from_matrix(decoder.rotations(poses.latent).reshape(-1, 3, 3)).as_quat(scalar_first=True)
    root = Rotation.from_rotvec(poses.orient.astype(np.float64)).as_quat(scalar_first=True)
    joints = forward_kinematics(
        rest, poses.trans.astype(np.float64) + rest[0], root, local.reshape(len(poses.frames), -1, 4)
    )
    return gimo.LocalJoints(poses.frames, joints, "smplx")
