"""Features to joints in NumPy, from positions or from rotations (docs/specification/humanml3d.md#inverse)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.representation.encoding import yaw_matrices
from prbench.representation.features import (
    JOINT_POSITIONS,
    JOINT_ROTATIONS,
    REST_OFFSETS,
    ROOT_HEIGHT,
    ROOT_LINEAR_VELOCITY,
    ROOT_YAW_VELOCITY,
    ROTATION_PARENTS,
)
from prbench.skeleton import N_JOINTS, PARENTS, Joint


def decode(features: Float[np.ndarray, "*batch frames 263"]) -> Float[np.ndarray, "*batch frames 22 3"]:
    """Joints of every row from its position features; the motion starts over the origin, facing +Z.

    Args:
        features: Raw features, not standardised. Rows depend on earlier rows only, so padding may hold anything.

    Returns:
        Canonical frame, metres, float32.
    """
    rows = features.astype(np.float64)
    pelvis, world_from_heading = _root(rows)
    seen_from_heading = rows[..., JOINT_POSITIONS].reshape(*rows.shape[:-1], N_JOINTS - 1, 3)
    joints = np.empty((*rows.shape[:-1], N_JOINTS, 3))
    joints[..., Joint.PELVIS, :] = pelvis
    joints[..., 1:, :] = seen_from_heading @ np.swapaxes(world_from_heading, -1, -2)
    joints[..., 1:, ::2] += pelvis[..., None, ::2]
    return joints.astype(np.float32)


def decode_rotations(
    features: Float[np.ndarray, "*batch frames 263"], offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS
) -> Float[np.ndarray, "*batch frames 22 3"]:
    """Joints of every row from its rotation features: forward kinematics with constant bone lengths.

    Args:
        features: Raw features, not standardised; six numbers that are no rotation are made one (Gram-Schmidt).
        offsets: Rest offset of each joint from its parent, metres: the uniform skeleton's, or those of a body's own
            bone lengths (:func:`prbench.representation.rest_offsets`).

    Returns:
        Canonical frame, metres, float32.
    """
    rows = features.astype(np.float64)
    pelvis, world_from_heading = _root(rows)
    relative = _matrices(rows[..., JOINT_ROTATIONS].reshape(*rows.shape[:-1], N_JOINTS - 1, 6))
    rotations = [np.swapaxes(world_from_heading, -1, -2)]
    joints = [pelvis]
    for joint in range(1, N_JOINTS):
        rotations.append(rotations[ROTATION_PARENTS[joint]] @ relative[..., joint - 1, :, :])
        joints.append(joints[PARENTS[joint]] + rotations[joint] @ offsets[joint])
    return np.stack(joints, axis=-2).astype(np.float32)


def _root(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pelvis (..., N, 3) and the rotation (..., N, 3, 3) from each heading to the world."""
    half_yaw = _sum_before(rows[..., ROOT_YAW_VELOCITY])[..., 0]  # the sum of half turns is half the yaw
    world_from_heading = yaw_matrices(np.cos(2 * half_yaw), -np.sin(2 * half_yaw))

    steps = np.zeros((*rows.shape[:-1], 3))
    steps[..., 1:, ::2] = rows[..., :-1, ROOT_LINEAR_VELOCITY]
    pelvis = np.cumsum((world_from_heading @ steps[..., None])[..., 0], axis=-2)
    pelvis[..., 1] = rows[..., ROOT_HEIGHT][..., 0]
    return pelvis, world_from_heading


def _sum_before(values: np.ndarray) -> np.ndarray:
    """Sum over all earlier rows: 0 in row 0."""
    total = np.zeros_like(values)
    np.cumsum(values[..., :-1, :], axis=-2, out=total[..., 1:, :])
    return total


def _matrices(columns: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) from their first two columns (..., 6)."""
    first, second = columns[..., :3], columns[..., 3:]
    first = first / np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-12)
    second = second - (first * second).sum(axis=-1, keepdims=True) * first
    second = second / np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), 1e-12)
    return np.stack([first, second, np.cross(first, second)], axis=-1)
