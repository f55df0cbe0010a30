"""MANO: the licensed hand model and its posing (docs/specification/hot3d.md#files).

HOT3D gives 10 shape numbers, 15 coefficients of the pose, an orientation and a *translation*: the model is turned about
its own root joint and then moved, so the wrist lies at translation + root joint at rest, about 11 cm from the former.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

N_VERTICES, N_JOINTS, N_BETAS, N_COEFFICIENTS = 778, 16, 10, 15
MODEL_KEYS = (
    "v_template",
    "shapedirs",
    "posedirs",
    "weights",
    "J_regressor",
    "kintree_table",
    "hands_components",
    "hands_mean",
    "f",
)


@dataclass(frozen=True)
class ManoModel:
    """One hand of the model; metres."""

    template: Float[np.ndarray, "v 3"]
    shape_directions: Float[np.ndarray, "v 3 10"]
    pose_directions: Float[np.ndarray, "v 3 135"]
    weights: Float[np.ndarray, "v 16"]
    regressor: Float[np.ndarray, "16 v"]
    parents: Int[np.ndarray, "16"]
    """-1 of the root."""
    components: Float[np.ndarray, "15 45"]
    """The first 15 principal poses."""
    mean_pose: Float[np.ndarray, "45"]
    """Rotation vectors of the 15 finger joints."""


def without_left_hand_bug(left: ManoModel, right: ManoModel) -> ManoModel:
    """The left hand with its shape directions mirrored in x, where the file holds those of the right hand.

    The model's first release has this mistake (smplx issue 48); HOT3D's hands were fitted without it.
    """
    if np.abs(left.shape_directions[:, 0] - right.shape_directions[:, 0]).sum() >= 1:
        return left
    return replace(left, shape_directions=left.shape_directions * np.array([-1.0, 1.0, 1.0])[:, None])


def pose_hand(
    model: ManoModel,
    betas: Float[np.ndarray, "10"],
    coefficients: Float[np.ndarray, "n 15"],
    rotation: Float[np.ndarray, "n 4"],
    translation: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n v 3"]]:
    """Wrist and vertices in the world.

    Args:
        model: The hand.
        betas: Shape.
        coefficients: Of the principal poses, added to the mean pose.
        rotation: Of the root joint, w x y z.
        translation: Added to everything, metres.
    """
    shaped = model.template + model.shape_directions @ betas
    joints = model.regressor @ shaped
    n = len(rotation)
    fingers = (model.mean_pose + coefficients @ model.components).reshape(-1, 3)
    local = np.empty((n, N_JOINTS, 3, 3))
    local[:, 0] = Rotation.from_quat(rotation, scalar_first=True).as_matrix().reshape(n, 3, 3)
    local[:, 1:] = Rotation.from_rotvec(fingers).as_matrix().reshape(n, N_JOINTS - 1, 3, 3)
    bend = (local[:, 1:] - np.eye(3)).reshape(n, -1)
    posed = shaped + np.einsum("vci,ni->nvc", model.pose_directions, bend, optimize=True)
    turn, shift = _joint_transforms(model.parents, joints, local)
    blended_turn = np.einsum("vj,njab->nvab", model.weights, turn, optimize=True)
    vertices = np.einsum("nvab,nvb->nva", blended_turn, posed) + model.weights @ shift
    return joints[0] + translation, vertices + translation[:, None]


def _joint_transforms(
    parents: Int[np.ndarray, "16"], joints: Float[np.ndarray, "16 3"], local: Float[np.ndarray, "n 16 3 3"]
) -> tuple[Float[np.ndarray, "n 16 3 3"], Float[np.ndarray, "n 16 3"]]:
    """Rotation and shift of every joint against its rest: ``x -> turn x + shift``."""
    turn, place = np.empty_like(local), np.empty(local.shape[:3])
    turn[:, 0], place[:, 0] = local[:, 0], joints[0]
    for joint in range(1, N_JOINTS):
        parent = parents[joint]
        turn[:, joint] = turn[:, parent] @ local[:, joint]
        place[:, joint] = place[:, parent] + turn[:, parent] @ (joints[joint] - joints[parent])
    return turn, place - np.einsum("njab,jb->nja", turn, joints)
