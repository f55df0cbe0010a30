"""Joints to features in NumPy (docs/specification/humanml3d.md#forward-conversion, steps 5 to 8)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.representation.checks import IN_MEMORY, check_joints
from prbench.representation.features import (
    CONTACT_JOINTS,
    CONTACT_THRESHOLD,
    HALF_TURN_MIDWAYS,
    OPPOSITE,
    REFLECTION_SIGNS,
    REST_DIRECTIONS,
    ROTATION_PARENTS,
    Mode,
    heading_kernel,
)
from prbench.skeleton import PARENTS, Joint


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
    steps, here = motion[1:] - motion[:-1], motion[:-1]
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
    :func:`prbench.skeleton.facing_yaw`, and frame 0 is not turned at all.
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
    w, y = np.sqrt(x**2 + z**2) + z, -x
    length = np.sqrt(w**2 + y**2)
    y[length == 0], length[length == 0] = 1.0, 1.0  # exactly opposite: half a turn
    w, y = w / length, y / length
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
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    return np.stack([cos, zero, sin, zero, one, zero, -sin, zero, cos], axis=-1).reshape(*cos.shape, 3, 3)


def _turned(vectors: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) turned about +Y; angles broadcast against their leading axes."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 1e-12, length, 1.0)
