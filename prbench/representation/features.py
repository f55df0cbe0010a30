"""The 263 numbers of a frame, and the constants of the skeleton behind them.

Sources: docs/specification/humanml3d.md#skeleton and docs/specification/humanml3d.md#forward-conversion.

A row describes frame t and the step from t to t + 1, both seen from the body's own heading. Metres, radians, frames.

Mean and standard deviation of features are those of docs/specification/humanml3d.md#normalisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.errors import UsageError
from prbench.geometry.skeleton import CHAINS, N_JOINTS, Joint

N_FEATURES = 263
# Frames a second that the features are made for; contact threshold and smoothing are per frame at this rate.
FRAME_RATE = 20.0

# Half the turn of the heading from this frame to the next, radians (one column).
ROOT_YAW_VELOCITY = slice(0, 1)
# Step of the pelvis along x and z to the next frame, seen from the next frame's heading, metres.
ROOT_LINEAR_VELOCITY = slice(1, 3)
# Height of the pelvis, metres.
ROOT_HEIGHT = slice(3, 4)
# Joints 1 to 21 relative to the ground point under the pelvis, seen from the heading; y is height. Metres.
JOINT_POSITIONS = slice(4, 67)
# Rotations of joints 1 to 21: the first two columns of each matrix, one after the other.
JOINT_ROTATIONS = slice(67, 193)
# Steps of all 22 joints to the next frame, seen from this frame's heading, metres.
JOINT_VELOCITIES = slice(193, 259)
# 1 where left ankle, left foot, right ankle, right foot move less than the contact threshold, else 0.
FOOT_CONTACTS = slice(259, 263)

# The seven blocks in the order of their columns; each shares one standard deviation.
BLOCKS = MappingProxyType(
    {
        "root_yaw_velocity": ROOT_YAW_VELOCITY,
        "root_linear_velocity": ROOT_LINEAR_VELOCITY,
        "root_height": ROOT_HEIGHT,
        "joint_positions": JOINT_POSITIONS,
        "joint_rotations": JOINT_ROTATIONS,
        "joint_velocities": JOINT_VELOCITIES,
        "foot_contacts": FOOT_CONTACTS,
    }
)

# ``reference`` reproduces the yaw that the original loses when the heading passes the opposite of its start;
# ``continuous`` loses none. Without such a passage the two are equal.
Mode = Literal["continuous", "reference"]

CONTACT_JOINTS = (Joint.LEFT_ANKLE, Joint.LEFT_FOOT, Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT)
# Squared step of a joint below which it touches the ground, square metres; no height is tested.
CONTACT_THRESHOLD = 0.002

# The 161 weights of the Gaussian that smooths the heading over time: sigma 20 frames, cut at four sigma.
_frames = np.arange(-80, 81)
HEADING_KERNEL = np.exp(-0.5 * (_frames / 20.0) ** 2)
HEADING_KERNEL /= HEADING_KERNEL.sum()

_X, _Y, _Z = np.eye(3)
# Direction of the bone that ends in each joint (22, 3), in the rest pose; zero for the pelvis.
REST_DIRECTIONS = np.array(
    [0 * _X, _X, -_X, _Y, -_Y, -_Y, _Y, -_Y, -_Y, _Y, _Z, _Z, _Y, _X, -_X, _Z, -_Y, -_Y, -_Y, -_Y, -_Y, -_Y]
)

# Lengths (22,) of the uniform skeleton's bones by the joint in which they end, metres.
BONE_LENGTHS = np.array(
    [0.0, 0.103100181, 0.109867722, 0.131602719, 0.393589228, 0.390126109, 0.14316383, 0.432214946, 0.425707549,
     0.057362135, 0.143381089, 0.149540886, 0.219349399, 0.137450144, 0.143360779, 0.103108704, 0.131557733,
     0.123003282, 0.256924629, 0.263132274, 0.266010493, 0.269717634]
)  # fmt: skip

# The uniform skeleton (22, 3): rest offset of each joint from its parent, metres.
REST_OFFSETS = REST_DIRECTIONS * BONE_LENGTHS[:, None]


# Joint whose rotation each joint's rotation is relative to; 0 stands for the root's heading, from which the two arm
# chains start again.
ROTATION_PARENTS = [0] * N_JOINTS
for _chain in CHAINS:
    for _parent, _joint in pairwise(_chain[1:]):
        ROTATION_PARENTS[_joint] = _parent

# Direction half-way of the turn of a bone that is exactly opposite to its rest direction: bones along x and y turn
# about z, those along z about y, and the half-way direction is orthogonal to both.
HALF_TURN_MIDWAYS = np.cross(np.where(np.abs(REST_DIRECTIONS[:, 2:]) > 0, _Y, _Z), REST_DIRECTIONS)

# Diagonal (22, 3) of 2 u u' - 1 for the rest direction u, used to write the shortest rotation as two reflections.
REFLECTION_SIGNS = 2.0 * np.abs(REST_DIRECTIONS) - 1.0

# Length of (rest direction + bone direction) below which a bone counts as exactly opposite to its rest direction.
OPPOSITE = 1e-6


_CONSTANT = 1e-8  # a block that varies less is left unscaled
_EVALUATOR_WEIGHT = 25.0
_WEIGHTED = (ROOT_YAW_VELOCITY, ROOT_LINEAR_VELOCITY, ROOT_HEIGHT, FOOT_CONTACTS)


@dataclass(frozen=True)
class Statistics:
    """Mean and deviation that features are standardised with; kept beside the weights that learnt from them.

    Attributes:
        mean: Mean of each feature, float32.
        std: One number a block: the average of the standard deviations in it, float32.
    """

    mean: Float[np.ndarray, " 263"]
    std: Float[np.ndarray, " 263"]

    def standardise(self, features: Float[np.ndarray, "*batch 263"]) -> Float[np.ndarray, "*batch 263"]:
        """``(features - mean) / std``."""
        return (features - self.mean) / self.std

    def restore(self, standardised: Float[np.ndarray, "*batch 263"]) -> Float[np.ndarray, "*batch 263"]:
        """Return the inverse of :meth:`standardise`."""
        return standardised * self.std + self.mean

    def for_evaluator(self) -> Statistics:
        """Weight root and contacts up as text-to-motion evaluators do.

        Their standard deviation is divided by 25, the measured ratio of the published ones.
        """
        std = self.std.copy()
        for block in _WEIGHTED:
            std[block] /= _EVALUATOR_WEIGHT
        return Statistics(self.mean, std)


class StatisticsAccumulator:
    """Statistics of a corpus that does not fit into memory, motion by motion.

    The result depends on the features only, up to rounding in float64, not on how they were portioned.

    >>> accumulator = StatisticsAccumulator()
    >>> accumulator.add(np.zeros((4, 263), dtype=np.float32))
    True
    >>> float(accumulator.result().std[0])  # constant features stay as they are
    1.0
    """

    def __init__(self) -> None:
        self._count = 0
        self._mean = np.zeros(N_FEATURES)
        self._squares = np.zeros(N_FEATURES)  # sum of squared distances from the mean
        self.skipped = 0
        """Motions that were left out because they hold NaN."""

    @property
    def count(self) -> int:
        """Rows so far."""
        return self._count

    def add(self, features: Float[np.ndarray, "rows 263"]) -> bool:
        """Add the raw features of a motion; one that holds NaN is left out, as in the original.

        Returns:
            Whether it was added.
        """
        if not len(features):
            return False
        if not np.isfinite(features).all():
            self.skipped += 1
            return False
        rows = features.astype(np.float64)
        mean = rows.mean(axis=0)
        count = len(rows)
        # Join two portions by their counts, means and squares (Chan, Golub and LeVeque, 1983).
        total = self._count + count
        apart = mean - self._mean
        self._mean = self._mean + apart * (count / total)
        self._squares = self._squares + ((rows - mean) ** 2).sum(axis=0) + apart**2 * (self._count * count / total)
        self._count = total
        return True

    def result(self) -> Statistics:
        """Mean of each feature and standard deviation of each block; a constant block gets 1.

        Raises:
            UsageError: if nothing was added.
        """
        if not self._count:
            problem = f"expected motions to take them from, found none ({self.skipped} left out for NaN)."
            raise UsageError(f"statistics: {problem}")
        each = np.sqrt(self._squares / self._count)
        std = np.empty(N_FEATURES)
        for block in BLOCKS.values():
            std[block] = each[block].mean()
        std[std < _CONSTANT] = 1.0
        return Statistics(self._mean.astype(np.float32), std.astype(np.float32))
