"""The 22 joints of SMPL parameters without the package ``smplx``: rest joints and forward kinematics in NumPy."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.representation.converters.smpl.body_model import RestJoints
from prbench.representation.converters.smpl.parameters import SmplParameters
from prbench.representation.converters.smpl.quaternions import to_matrices
from prbench.skeleton import N_JOINTS, PARENTS, Joint


def smpl_joints(parameters: SmplParameters, rest: RestJoints) -> Float[np.ndarray, "frames 22 3"]:
    """Joints as the body model has them; blend shapes of the surface move none of them, so this is exact.

    SMPL, SMPL-H and SMPL-X share the order of these 22 joints, not their rest joints: take the model that the
    parameters were made for.

    Args:
        parameters: The motion.
        rest: Rest joints of the model.

    Returns:
        World of the parameters (AMASS: Z up), metres, at their rate.

    Raises:
        InputFileError: if there are more shape numbers than the model knows.
    """
    body = rest.of(parameters.betas)
    local = to_matrices(parameters.rotations)
    world = [local[:, Joint.PELVIS]]
    joints = [parameters.transl + body[Joint.PELVIS]]
    for joint in range(1, N_JOINTS):
        parent = PARENTS[joint]
        joints.append(joints[parent] + world[parent] @ (body[joint] - body[parent]))
        world.append(world[parent] @ local[:, joint])
    return np.stack(joints, axis=1)
