"""Motions that turn and walk, for the tests of the representation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.representation import canonicalise
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
