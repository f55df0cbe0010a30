"""Turning vectors, two-bone limbs and quaternions, vectorised over frames.

Angles are radians: yaw about +Y (0 faces +Z, positive turns left), pitch > 0 looks or leans down, and
R = Ry(yaw) Rx(pitch).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

UP = np.array([0.0, 1.0, 0.0])


def turn(yaw: np.ndarray | float, pitch: np.ndarray | float, vector: np.ndarray) -> np.ndarray:
    """Apply Ry(yaw) Rx(pitch) to a vector; all arguments broadcast over the leading axes."""
    x = vector[..., 0]
    y = vector[..., 1]
    z = vector[..., 2]
    cos_pitch = np.cos(pitch)
    sin_pitch = np.sin(pitch)
    tipped_y = y * cos_pitch - z * sin_pitch
    tipped_z = y * sin_pitch + z * cos_pitch
    cos_yaw = np.cos(yaw)
    sin_yaw = np.sin(yaw)
    turned_x = x * cos_yaw + tipped_z * sin_yaw
    turned = np.empty((*np.broadcast_shapes(np.shape(turned_x), np.shape(tipped_y)), 3))
    turned[..., 0], turned[..., 1], turned[..., 2] = turned_x, tipped_y, tipped_z * cos_yaw - x * sin_yaw
    return turned


def rotation(yaw: np.ndarray | float, pitch: np.ndarray | float) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the matrix Ry(yaw) Rx(pitch); its columns are left, up and forward of the turned frame."""
    return np.stack([turn(yaw, pitch, axis) for axis in np.eye(3)], axis=-1)


def rotation_quaternion(yaw: np.ndarray, pitch: np.ndarray) -> Float[np.ndarray, "*batch 4"]:
    """Return the quaternion (w x y z) of Ry(yaw) Rx(pitch), w >= 0."""
    cos_yaw, sin_yaw, cos_pitch, sin_pitch = (f(angle / 2.0) for angle in (yaw, pitch) for f in (np.cos, np.sin))
    turned = np.stack([cos_yaw * cos_pitch, cos_yaw * sin_pitch, sin_yaw * cos_pitch, -sin_yaw * sin_pitch], axis=-1)
    return np.where(turned[..., :1] < 0.0, -turned, turned)


def direction(yaw: np.ndarray | float, pitch: np.ndarray | float) -> np.ndarray:
    """Return the unit vector that looks along yaw and pitch."""
    cos_pitch = np.cos(pitch)
    parts = np.broadcast_arrays(np.sin(yaw) * cos_pitch, -np.sin(pitch), np.cos(yaw) * cos_pitch)
    return np.stack(parts, axis=-1)


def yaw_and_pitch(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the yaw and pitch of a direction; inverse of :func:`direction` up to full turns."""
    x = vector[..., 0]
    y = vector[..., 1]
    z = vector[..., 2]
    return np.asarray(np.arctan2(x, z)), np.asarray(-np.arctan2(y, np.hypot(x, z)))


def unit(vector: np.ndarray) -> np.ndarray:
    """Divide a vector by its length."""
    return vector / np.sqrt(np.einsum("...i,...i->...", vector, vector))[..., None]


def orthogonal_unit(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the unit part of ``vector`` orthogonal to the unit vector ``axis``."""
    return unit(vector - np.einsum("...i,...i->...", vector, axis)[..., None] * axis)


def soft_limit(ratio: np.ndarray, begin: float, end: float) -> np.ndarray:
    """Return the ratio itself up to ``begin``, then a number that nears ``end`` smoothly without reaching it."""
    width = end - begin
    return np.where(ratio > begin, begin + width * np.tanh((ratio - begin) / width), ratio)


def two_bone(
    root: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, "n 3"],
    lengths: tuple[float, float],
    pole: Float[np.ndarray, "n 3"],
    limit: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and end joint of a limb that reaches from ``root`` towards ``target`` and bends towards ``pole``.

    Args:
        root: Hip or shoulder.
        target: Wanted ankle or wrist.
        lengths: Upper and lower bone.
        pole: Direction into which the middle joint points; need not be unit or orthogonal.
        limit: Extension (distance over limb length) at which the soft limit begins, and its end below 1.

    Returns:
        Knee or elbow, and the ankle or wrist at the softly limited distance.
    """
    upper, lower = lengths
    offset = target - root
    wanted = np.sqrt(np.einsum("...i,...i->...", offset, offset))
    along = offset / wanted[..., None]
    distance = soft_limit(wanted / (upper + lower), *limit) * (upper + lower)
    cosine = np.clip((upper**2 + distance**2 - lower**2) / (2.0 * upper * distance), -1.0, 1.0)
    across = orthogonal_unit(pole, along)
    middle = root + upper * (cosine[..., None] * along + np.sqrt(1.0 - cosine**2)[..., None] * across)
    return middle, root + distance[..., None] * along


def frame_of_bone(along: np.ndarray, hinge: np.ndarray) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the rotation whose y axis lies along a bone and whose x axis is as near to ``hinge`` as possible."""
    y = unit(along)
    x = orthogonal_unit(hinge, y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def quaternion(matrix: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Return the quaternions (w x y z) of rotation matrices; w >= 0 up to rounding."""
    m = matrix
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    squares = np.stack(
        [
            1.0 + trace,
            1.0 + 2.0 * m[..., 0, 0] - trace,
            1.0 + 2.0 * m[..., 1, 1] - trace,
            1.0 + 2.0 * m[..., 2, 2] - trace,
        ],
        axis=-1,
    )
    wx = m[..., 2, 1] - m[..., 1, 2]
    wy = m[..., 0, 2] - m[..., 2, 0]
    wz = m[..., 1, 0] - m[..., 0, 1]
    xy = m[..., 0, 1] + m[..., 1, 0]
    xz = m[..., 0, 2] + m[..., 2, 0]
    yz = m[..., 1, 2] + m[..., 2, 1]
    w2, x2, y2, z2 = np.moveaxis(squares, -1, 0)
    candidates = np.stack(
        [
            np.stack([w2, wx, wy, wz], axis=-1),
            np.stack([wx, x2, xy, xz], axis=-1),
            np.stack([wy, xy, y2, yz], axis=-1),
            np.stack([wz, xz, yz, z2], axis=-1),
        ],
        axis=-2,
    )
    best = squares.argmax(axis=-1)
    chosen = unit(np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :])
    return np.where(chosen[..., :1] < 0.0, -chosen, chosen)


def matrix_of(quaternions: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the rotation matrices of unit quaternions (w x y z)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
