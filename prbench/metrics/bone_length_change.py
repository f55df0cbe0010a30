"""Bone length change: whether the body that moves stays the same body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import BONES
from prbench.metrics.batch import MotionBatch, ScoringPair
from prbench.metrics.registry import MetricFamily, MetricValues, detail
from prbench.protocol.manifests import MetricConstants

_NO_LENGTH = 1e-6  # metres; what float32 resolves a few metres from the origin


def bone_length_change(motion: MotionBatch) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Largest relative change of a bone against frame 0: max over bones and frames of ``|length / length_0 - 1|``.

    Args:
        motion: Metres, any frame.

    Returns:
        The change (docs/specification/metrics.md#bone-length-change), and which sequences have a bone of zero length in
        frame 0. Such a bone has no relative change and is left out.
    """
    change, missing = change_of_each_bone(motion)
    return change.max(axis=0), np.asarray(missing.any(axis=0))


def change_of_each_bone(motion: MotionBatch) -> tuple[Float[np.ndarray, "21 n"], Bool[np.ndarray, "21 n"]]:
    """Largest relative change of each bone against frame 0, in the order of :data:`~prbench.geometry.skeleton.BONES`.

    Args:
        motion: Metres, any frame.

    Returns:
        The change, 0 for a bone of zero length in frame 0, and which bones have no length there.
    """
    parents, children = np.transpose(BONES)
    squared = motion.columns[children]
    squared -= motion.columns[parents]
    squared *= squared
    squared = squared[:, 0] + squared[:, 1] + squared[:, 2]  # (bones, frames)
    initial = np.sqrt(squared[:, motion.first])
    longest = np.sqrt(np.maximum.reduceat(squared, motion.first, axis=1))
    shortest = np.sqrt(np.minimum.reduceat(squared, motion.first, axis=1))
    missing = initial < _NO_LENGTH
    deviation = np.maximum(longest - initial, initial - shortest)
    return np.where(missing, 0.0, deviation / np.where(missing, 1.0, initial)), missing


def _compute(pair: ScoringPair, _: MetricConstants) -> tuple[MetricValues]:
    change, missing = bone_length_change(pair.predicted)
    return (MetricValues("bone_length_change", change, {"zero_length_bone": missing}),)


_METRIC = detail("bone_length_change", "Bone length change", "ratio", 18, higher_is_better=False)
FAMILY = MetricFamily((_METRIC,), _compute)
