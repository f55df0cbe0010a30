"""Joints to features and features to joints, in NumPy.

Sources: docs/specification/humanml3d.md#forward-conversion, steps 5 to 8, and docs/specification/humanml3d.md#inverse.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.representation.clips import IN_MEMORY, check_joints
from prbench.representation.features import (
    CONTACT_JOINTS,
    CONTACT_THRESHOLD,
    HALF_TURN_MIDWAYS,
    JOINT_POSITIONS,
    JOINT_ROTATIONS,
    OPPOSITE,
    REFLECTION_SIGNS,
    REST_DIRECTIONS,
    REST_OFFSETS,
    ROOT_HEIGHT,
    ROOT_LINEAR_VELOCITY,
    ROOT_YAW_VELOCITY,
    ROTATION_PARENTS,
    Mode,
    heading_kernel,
)


def encode(
    joints: Float[np.ndarray, "frames ..."],
    *,
    next_joints: Float[np.ndarray, "22 3"] | None = None,
    mode: Mode = "continuous",
    source: Path | str = IN_MEMORY,
    upright: bool = True,
) -> Float[np.ndarray, "rows 263"]:
    """The features of a canonical motion, with its own bone lengths.

    Row t holds frame t and the step to frame t + 1. Without ``next_joints`` the last frame has no step and is lost, as
    in the original; with it there are as many rows as frames (docs/specification/pr-model.md#data-and-features). The
    heading is smoothed over two seconds on either side, so encode the final clip and never cut features.

    Args:
        joints: (frames, 22, 3), canonical frame (:func:`prbench.representation.canonicalise`), metres, 20 fps.
        next_joints: The frame after the last one, same frame: the recorded one, or a copy of the last.
        mode: What happens to the yaw when the heading passes the opposite of its start.
        source: File or name that messages begin with.
        upright: False for people who lie or crawl (:func:`prbench.representation.check_joints`).

    Returns:
        Raw features, float32: frames - 1 rows, or as many as frames with ``next_joints``.

    Raises:
        InputFileError: if positions are missing, not finite, in another unit or with another axis up, if a bone has no
            length, or if there is no step at all.
    """
    motion = np.asarray(joints, dtype=np.float64)
    if next_joints is not None:
        motion = np.concatenate([motion, np.asarray(next_joints, dtype=np.float64)[None]])
    check_joints(motion, source=source, upright=upright)

    cos, sin, half_turns = _headings(motion, mode)
    steps = motion[1:] - motion[:-1]
    here = motion[:-1]
    pelvis = here[:, Joint.PELVIS]
    root_steps = _turned(steps[:, Joint.PELVIS], cos[1:], sin[1:])  # seen from the frame they lead to
    positions = _turned(here[:, 1:] - (pelvis * (1, 0, 1))[:, None], cos[:-1, None], sin[:-1, None])
    rotations = _rotations(here, cos[:-1], sin[:-1])
    velocities = _turned(steps, cos[:-1, None], sin[:-1, None])
    contacts = (steps[:, CONTACT_JOINTS] ** 2).sum(axis=-1) < CONTACT_THRESHOLD
    rows = len(here)
    blocks = (half_turns[:, None], root_steps[:, ::2], pelvis[:, 1:2], positions, rotations, velocities, contacts)
    return np.concatenate([block.reshape(rows, -1) for block in blocks], axis=1).astype(np.float32)


def _headings(motion: np.ndarray, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosine and sine (N,) of the turn from the world to each frame's heading, and the half angles (N-1,) between them.

    Two quirks of the original are part of the representation: the hips enter with the opposite sign of
    :func:`prbench.geometry.skeleton.facing_yaw`, and frame 0 is not turned at all.
    """
    if mode == "reference":
        return _reference_headings(_forward(motion.astype(np.float32)))
    x, z = _forward(motion).T
    x[0], z[0] = 0.0, 1.0
    turns = np.diff(0.5 * np.arctan2(-x, z))
    return z, -x, turns - np.pi * np.round(turns / np.pi)


def _reference_headings(forward: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Headings through quaternions (w, y) of positive w and in single precision, to the rounding of the original.

    Opposite to +Z w comes close to 0: there the original's rounding is larger than the tolerance of a comparison.
    """
    x, z = forward.T
    w = np.sqrt(x**2 + z**2) + z
    y = -x
    length = np.sqrt(w**2 + y**2)
    y[length == 0], length[length == 0] = 1.0, 1.0  # exactly opposite: half a turn
    w = w / length
    y = y / length
    w[0], y[0] = 1.0, 0.0
    return w**2 - y**2, 2 * w * y, np.arcsin(np.clip(y[1:] * w[:-1] - w[1:] * y[:-1], -1, 1))


def _forward(motion: np.ndarray) -> np.ndarray:
    """Smoothed x and z (N, 2) of the unit forward vector Y x across; +Z without any heading."""
    from scipy.ndimage import correlate1d  # late: 0.3 s that a run and its workers do not need

    hips = motion[:, Joint.LEFT_HIP] - motion[:, Joint.RIGHT_HIP]
    shoulders = motion[:, Joint.RIGHT_SHOULDER] - motion[:, Joint.LEFT_SHOULDER]
    across = _unit(hips + shoulders)
    forward = np.stack([across[:, 2], -across[:, 0]], axis=1)
    forward = _unit(correlate1d(forward, heading_kernel(), axis=0, mode="nearest"))
    forward[~forward.any(axis=1)] = 0.0, 1.0
    return forward


def _rotations(frames: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Six numbers (N, 21, 6) a joint: the first two columns of its bone's rotation, seen from the bone before it.

    The shortest rotation from the rest direction u to the bone's direction v is the reflection at u followed by that at
    the direction w half-way between them, ``(2 w w' - 1)(2 u u' - 1)``; unlike the quaternion's formula it keeps its
    precision when v comes close to -u.
    """
    directions = _unit(frames[:, 1:] - frames[:, PARENTS[1:]])
    midways = directions + REST_DIRECTIONS[1:]
    opposite = (midways**2).sum(axis=-1, keepdims=True) < OPPOSITE**2
    midways = _unit(np.where(opposite, HALF_TURN_MIDWAYS[1:], midways))
    reflections = 2 * midways[..., :, None] * midways[..., None, :] - np.eye(3)
    bones = reflections * REFLECTION_SIGNS[1:, None, :]

    before = np.concatenate([yaw_matrices(cos, sin)[:, None], bones], axis=1)[:, ROTATION_PARENTS[1:]]
    relative = np.swapaxes(before, -1, -2) @ bones[..., :2]
    return np.swapaxes(relative, -1, -2).reshape(len(frames), -1, 6)


def yaw_matrices(cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) about +Y by the angles with these cosines and sines."""
    zero = np.zeros_like(cos)
    one = np.ones_like(cos)
    return np.stack([cos, zero, sin, zero, one, zero, -sin, zero, cos], axis=-1).reshape(*cos.shape, 3, 3)


def _turned(vectors: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) turned about +Y; angles broadcast against their leading axes."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 1e-12, length, 1.0)


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
    first = columns[..., :3]
    second = columns[..., 3:]
    first = first / np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-12)
    second = second - (first * second).sum(axis=-1, keepdims=True) * first
    second = second / np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), 1e-12)
    return np.stack([first, second, np.cross(first, second)], axis=-1)
