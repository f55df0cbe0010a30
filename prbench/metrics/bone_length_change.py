"""Bone length change: whether the body that moves stays the same body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import BONES, CHAINS, Joint
from prbench.metrics.batch import MotionBatch, ScoringPair
from prbench.metrics.registry import MetricFamily, MetricValues, detail
from prbench.protocol.manifests import MetricConstants

_NO_LENGTH = 1e-6  # metres; what float32 resolves a few metres from the origin


_LEGS = (CHAINS[1][1:4], CHAINS[0][1:4])
_ARMS = (CHAINS[4][2:], CHAINS[3][2:])  # left and right: shoulder, elbow, wrist
_TRUNK = (Joint.PELVIS, Joint.SPINE1, Joint.SPINE2, Joint.SPINE3, Joint.NECK, Joint.HEAD)


def bone_length_change(
    motion: MotionBatch, poses: Float[np.ndarray, "n 22 3"] | None = None
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Largest relative change of a bone against a pose: max over bones and frames of ``|length / length_0 - 1|``.

    Args:
        motion: Metres, any frame.
        poses: Pose that each sequence is compared with, metres; its own frame 0 by default.

    Returns:
        The change (docs/specification/metrics.md#bone-length-change), and which sequences have a bone of zero length in
        that pose. Such a bone has no relative change and is left out.
    """
    # The largest change of each bone in any frame, from the squares of its lengths.
    parents, children = np.transpose(BONES)
    squared = motion.columns[children]
    squared -= motion.columns[parents]
    squared *= squared
    squared = squared[:, 0] + squared[:, 1] + squared[:, 2]  # (bones, frames)
    initial = np.sqrt(squared[:, motion.first])
    if poses is not None:
        initial = np.linalg.norm(poses[:, children] - poses[:, parents], axis=-1).T
    longest = np.sqrt(np.maximum.reduceat(squared, motion.first, axis=1))
    shortest = np.sqrt(np.minimum.reduceat(squared, motion.first, axis=1))
    missing = initial < _NO_LENGTH
    deviation = np.maximum(longest - initial, initial - shortest)
    change = np.where(missing, 0.0, deviation / np.where(missing, 1.0, initial))
    return change.max(axis=0), np.asarray(missing.any(axis=0))


def body_length(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Length of a leg from hip to ankle (mean of both) and of the trunk from pelvis to head, bone by bone, in frame 0.

    It hardly depends on the pose (docs/specification/metrics.md#bone-length-change).

    Args:
        motion: Metres, any frame.
    """
    return _limbs(motion, _LEGS).mean(axis=0) + _limbs(motion, (_TRUNK,))[0]


def arm_shares(motion: MotionBatch) -> Float[np.ndarray, "2 n"]:
    """Length of the left and of the right arm from shoulder to wrist in frame 0, as shares of :func:`body_length`.

    Args:
        motion: Metres, any frame.
    """
    return _limbs(motion, _ARMS) / np.maximum(body_length(motion), _NO_LENGTH)


def _limbs(motion: MotionBatch, chains: tuple[tuple[int, ...], ...]) -> Float[np.ndarray, "chains n"]:
    poses = motion.values[motion.first].astype(np.float64)
    return np.stack([np.linalg.norm(np.diff(poses[:, chain], axis=1), axis=-1).sum(axis=1) for chain in chains])


def _compute(pair: ScoringPair, _: MetricConstants) -> tuple[MetricValues]:
    change, missing = bone_length_change(pair.predicted)
    return (MetricValues("bone_length_change", change, {"zero_length_bone": missing}),)


_METRIC = detail("bone_length_change", "Bone length change", "ratio", 18, higher_is_better=False)
FAMILY = MetricFamily((_METRIC,), _compute)
