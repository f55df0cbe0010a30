"""Motions that turn and walk, for the tests of the representation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.geometry.skeleton import N_JOINTS, PARENTS
from prbench.representation import REST_OFFSETS, canonicalise, decode
from prbench.representation.encoding import yaw_matrices
from prbench.representation.features import JOINT_ROTATIONS, ROTATION_PARENTS
from tests.fakes import smooth_motion

GOLDEN = ("antipode", "child", "five_frames", "long", "static", "straight", "turn90", "two_frames")


def golden(samples: Path, case: str) -> dict[str, np.ndarray]:
    with np.load(samples / "humanml3d" / "golden" / f"golden_{case}.npz") as file:
        return dict(file)


def turned(joints: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    """About +Y; ``yaw`` is one angle or one a frame; positive turns +Z towards +X."""
    cos, sin = (np.asarray(f(yaw))[..., None] for f in (np.cos, np.sin))
    x, y, z = np.moveaxis(joints.astype(np.float64), -1, 0)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def walk(name: str, n_frames: int, *, turn: float = 2.0, length: float = 3.0) -> np.ndarray:
    """Canonical joints (n_frames, 22, 3) float32 of a body that sways, turns by ``turn`` radians and walks."""
    phase = np.linspace(0, 1, n_frames)
    joints = turned(smooth_motion(name, n_frames), turn * phase**2)
    joints[:, :, 0] += (length * np.sin(phase))[:, None]
    joints[:, :, 2] += (length * phase)[:, None]
    return canonicalise(joints.astype(np.float32))


def decode_rotations(features: np.ndarray, offsets: np.ndarray = REST_OFFSETS) -> np.ndarray:
    """Joints (..., frames, 22, 3) from the rotation features alone: forward kinematics on the bones of ``offsets``."""
    rows = features.astype(np.float64)
    half_yaw = np.cumsum(rows[..., 0], axis=-1) - rows[..., 0]
    columns = rows[..., JOINT_ROTATIONS].reshape(*rows.shape[:-1], N_JOINTS - 1, 6)
    first, second = columns[..., :3], columns[..., 3:]
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    second = second - (first * second).sum(axis=-1, keepdims=True) * first
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    relative = np.stack([first, second, np.cross(first, second)], axis=-1)
    rotations = [np.swapaxes(yaw_matrices(np.cos(2 * half_yaw), -np.sin(2 * half_yaw)), -1, -2)]
    joints = [decode(features)[..., 0, :]]
    for joint in range(1, N_JOINTS):
        rotations.append(rotations[ROTATION_PARENTS[joint]] @ relative[..., joint - 1, :, :])
        joints.append(joints[PARENTS[joint]] + rotations[joint] @ offsets[joint])
    return np.stack(joints, axis=-2)
