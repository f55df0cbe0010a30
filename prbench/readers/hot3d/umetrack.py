"""UmeTrack: the hand model of a user profile and its posing by linear blend skinning.

Source: docs/specification/hot3d.md#files.

The model describes the left hand in the frame of its wrist; a right hand is its mirror image in x. Lengths are metres
here, millimetres in the files.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

N_JOINTS = 22
N_ANGLES = 20
"""Angles that move bones; joints 20 and 21 are unused."""
N_FINGERS, JOINTS_A_FINGER, BONES_A_FINGER = 5, 4, 3
N_BONES = 2 + N_FINGERS * BONES_A_FINGER
"""Root and wrist, which never move, then three a finger, thumb to little."""
N_LANDMARKS, WRIST_LANDMARK, PALM_LANDMARK = 21, 5, 20
METRES_A_UNIT = 1e-3


@dataclass(frozen=True)
class HandModel:
    """One user's left hand, at rest, in the frame of its wrist."""

    vertices: Float[np.ndarray, "v 3"]
    weights: Float[np.ndarray, "v 17"]
    """Share of each bone in each vertex; rows sum to 1."""
    joint_positions: Float[np.ndarray, "22 3"]
    joint_axes: Float[np.ndarray, "22 3"]
    landmarks: Float[np.ndarray, "21 3"]
    """Finger tips thumb to little, wrist, two of the thumb, three a finger, palm."""
    landmark_weights: Float[np.ndarray, "21 17"]
    triangles: Int[np.ndarray, "f 3"]


def bone_transforms(model: HandModel, angles: Float[np.ndarray, "n 22"]) -> Float[np.ndarray, "n 17 4 4"]:
    """Where every bone is in the frame of the wrist, relative to its rest.

    Args:
        model: Joints and axes.
        angles: Radians; the first 20 count.
    """
    turned = [
        _about(model.joint_axes[joint], model.joint_positions[joint], angles[:, joint]) for joint in range(N_ANGLES)
    ]
    bones = [np.broadcast_to(np.eye(4), (len(angles), 4, 4))] * 2
    for finger in range(N_FINGERS):
        first = finger * JOINTS_A_FINGER
        bone = turned[first]
        for joint in range(first + 1, first + JOINTS_A_FINGER):
            bone = bone @ turned[joint]
            bones.append(bone)
    return np.stack(bones, axis=1)


def pose_points(
    points: Float[np.ndarray, "v 3"],
    weights: Float[np.ndarray, "v 17"],
    bones: Float[np.ndarray, "n 17 4 4"],
    wrist_position: Float[np.ndarray, "n 3"],
    wrist_rotation: Float[np.ndarray, "n 4"],
    *,
    mirrored: bool,
) -> Float[np.ndarray, "n v 3"]:
    """World positions of points of the hand: linear blend skinning, then the wrist's pose.

    Args:
        points: At rest, in the frame of the wrist.
        weights: Share of each bone.
        bones: See :func:`bone_transforms`.
        wrist_position: In the world, metres.
        wrist_rotation: Wrist to world, w x y z.
        mirrored: Whether it is a right hand: the first column of the rotation is negated.
    """
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    # Weight times point is a constant of the model, so that one product poses all frames at once.
    carried = (weights[:, :, None] * homogeneous[:, None, :]).reshape(len(points), -1)
    flat = bones[:, :, :3].transpose(0, 1, 3, 2).reshape(len(bones), -1, 3)
    matrix = Rotation.from_quat(wrist_rotation, scalar_first=True).as_matrix()
    if mirrored:
        matrix = matrix * np.array([-1.0, 1.0, 1.0])
    return carried @ (flat @ matrix.transpose(0, 2, 1)) + wrist_position[:, None]


def _about(
    axis: Float[np.ndarray, "3"], point: Float[np.ndarray, "3"], angles: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4 4"]:
    """Rotations about an axis through a point."""
    transform = np.tile(np.eye(4), (len(angles), 1, 1))
    transform[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    transform[:, :3, 3] = point - transform[:, :3, :3] @ point
    return transform
