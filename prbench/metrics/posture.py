"""Height of the feet, depth below the floor, height of the pelvis, tilt of the trunk: extremes over a motion's frames.

The floor is Y = 0. Definitions: docs/specification/metrics.md#plausible.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import TOES, Joint
from prbench.metrics.batch import MotionBatch

_FEET = (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE, *TOES)


def floating(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Greatest height of the lower foot: max over frames of the lowest ankle or toe, at least 0; metres.

    Args:
        motion: Canonical frame, metres.
    """
    lowest_foot = motion.columns[list(_FEET), 1].min(axis=0)
    return np.maximum(np.maximum.reduceat(lowest_foot, motion.first), 0.0)


def penetration(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Greatest depth of a joint below the floor in any frame, at least 0; metres.

    Args:
        motion: Canonical frame, metres.
    """
    lowest_joint = motion.columns[:, 1].min(axis=0)
    return np.maximum(-np.minimum.reduceat(lowest_joint, motion.first), 0.0)


def lowest_pelvis(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Smallest height of the pelvis above the floor in any frame, metres.

    Args:
        motion: Canonical frame, metres.
    """
    return np.minimum.reduceat(motion.columns[Joint.PELVIS, 1], motion.first)


def largest_trunk_tilt(motion: MotionBatch) -> Float[np.ndarray, " n"]:
    """Largest angle between the line from pelvis to neck and the vertical in any frame, degrees.

    Args:
        motion: Any frame with Y up, metres.

    Returns:
        0 for an upright trunk, 90 for a level one, 180 for one upside down; 0 where neck and pelvis coincide.
    """
    trunk = motion.columns[Joint.NECK] - motion.columns[Joint.PELVIS]
    tilt = np.rad2deg(np.arctan2(np.sqrt(trunk[0] ** 2 + trunk[2] ** 2), trunk[1]))
    return np.maximum.reduceat(tilt, motion.first)
