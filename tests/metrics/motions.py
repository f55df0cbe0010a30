"""Motions for the metric tests: a standing body, bodies that look somewhere, and smooth random ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from prbench.geometry.skeleton import Joint
from prbench.metrics import MotionBatch, ScoringTargets
from prbench.protocol.manifests import load_protocol

CONSTANTS = load_protocol().metrics
FPS = 20.0

STANDING = np.zeros((22, 3))
STANDING[:, 1] = np.linspace(0.9, 1.1, 22)
STANDING[Joint.LEFT_HIP], STANDING[Joint.RIGHT_HIP] = (0.1, 0.85, 0), (-0.1, 0.85, 0)
STANDING[Joint.LEFT_KNEE], STANDING[Joint.RIGHT_KNEE] = (0.1, 0.45, 0), (-0.1, 0.45, 0)
STANDING[Joint.LEFT_ANKLE], STANDING[Joint.RIGHT_ANKLE] = (0.1, 0.08, 0), (-0.1, 0.08, 0)
STANDING[Joint.LEFT_FOOT], STANDING[Joint.RIGHT_FOOT] = (0.1, 0.02, 0.12), (-0.1, 0.02, 0.12)
STANDING[Joint.NECK], STANDING[Joint.HEAD] = (0, 1.5, 0), (0, 1.6, 0)
STANDING[Joint.LEFT_COLLAR], STANDING[Joint.RIGHT_COLLAR] = (0.06, 1.45, 0), (-0.06, 1.45, 0)
STANDING[Joint.LEFT_SHOULDER], STANDING[Joint.RIGHT_SHOULDER] = (0.18, 1.45, 0), (-0.18, 1.45, 0)
STANDING[Joint.LEFT_ELBOW], STANDING[Joint.RIGHT_ELBOW] = (0.2, 1.2, 0), (-0.2, 1.2, 0)
STANDING[Joint.LEFT_WRIST], STANDING[Joint.RIGHT_WRIST] = (0.2, 0.95, 0.05), (-0.2, 0.95, 0.05)


def standing(n_frames: int) -> np.ndarray:
    return np.repeat(STANDING[None], n_frames, axis=0)


def batch(*motions: np.ndarray) -> MotionBatch:
    return MotionBatch.from_motions([np.asarray(motion) for motion in motions])


def targets(
    n: int = 1, *, goal=(0.0, 1.6, 2.0), prime_time=0.2, hand=-1, tilt: ArrayLike = 0.0, fps=FPS, gaze=None
) -> ScoringTargets:
    return ScoringTargets(
        np.broadcast_to(np.asarray(goal, dtype=float), (n, 3)).copy(),
        np.broadcast_to(np.asarray(prime_time, dtype=float), (n,)).copy(),
        np.broadcast_to(np.asarray(hand, dtype=np.int64), (n,)).copy(),
        np.broadcast_to(np.asarray(tilt, dtype=float), (n,)).copy(),
        fps,
        gaze,
    )


def looking(angles_deg) -> np.ndarray:
    """A standing body whose shoulders turn: it looks at these angles to the left of +Z, in the horizontal plane."""
    motion = standing(len(angles_deg))
    angle = np.deg2rad(np.asarray(angles_deg, dtype=float))
    left = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], axis=-1)
    motion[:, Joint.LEFT_SHOULDER] = (0, 1.45, 0) + 0.18 * left
    motion[:, Joint.RIGHT_SHOULDER] = (0, 1.45, 0) - 0.18 * left
    return motion


def random_motion(rng: np.random.Generator, n_frames: int, *, dtype=np.float64) -> np.ndarray:
    """A body that walks, turns and waves smoothly, with toes near the floor."""
    seconds = np.arange(n_frames) / FPS
    noise = np.zeros((n_frames, 22, 3))
    for _ in range(3):
        frequency, phase = rng.uniform(0.1, 1.5, (22, 3)), rng.uniform(0, 6.3, (22, 3))
        noise += rng.normal(0, 0.03, (22, 3)) * np.sin(6.3 * frequency * seconds[:, None, None] + phase)
    motion = STANDING + noise
    yaw = rng.uniform(-2, 2) + rng.normal(0, 1.0) * np.sin(seconds * rng.uniform(0.5, 3) + rng.uniform(0, 6))
    motion = turned(motion, yaw)
    motion[..., [0, 2]] += (rng.normal(0, 0.5, 2) * seconds[:, None])[:, None]
    return motion.astype(dtype)


def turned(motion: np.ndarray, yaw) -> np.ndarray:
    """The motion turned about the Y axis through the origin."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    cosine, sine = (np.reshape(part, (-1, 1)) for part in (cosine, sine))
    x, y, z = motion[..., 0], motion[..., 1], motion[..., 2]
    return np.stack([cosine * x + sine * z, y + 0 * cosine, -sine * x + cosine * z], axis=-1)


def random_problem(seed: int, lengths, *, dtype=np.float64):
    """Predicted and recorded motions with targets that make every metric take both values now and then."""
    rng = np.random.default_rng(seed)
    recorded = [random_motion(rng, n, dtype=dtype) for n in lengths]
    predicted = [
        (motion + rng.normal(0, 0.1, 3) + 0.05 * random_motion(rng, len(motion))).astype(dtype) for motion in recorded
    ]
    n = len(lengths)
    goals = np.stack([motion[rng.integers(len(motion)), rng.integers(18, 22)] for motion in predicted]).astype(float)
    goals += rng.normal(0, 1, (n, 1)) * rng.normal(0, 0.3, (n, 3))
    spans = np.asarray(lengths) / FPS
    return (
        batch(*predicted),
        batch(*recorded),
        targets(n, goal=goals, prime_time=rng.uniform(-0.2, 1.1, n) * spans, hand=rng.integers(-1, 2, n), tilt=7.4),
    )
