"""The 263 numbers of a frame, and the constants of the skeleton behind them.

Sources: docs/specification/humanml3d.md#skeleton and docs/specification/humanml3d.md#forward-conversion.

A row describes frame t and the step from t to t + 1, both seen from the body's own heading. Metres, radians, frames.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Literal

import numpy as np

from prbench.geometry.skeleton import CHAINS, N_JOINTS, Joint

N_FEATURES = 263
FRAME_RATE = 20.0
"""Frames a second that the features are made for; contact threshold and smoothing are per frame at this rate."""

ROOT_YAW_VELOCITY = slice(0, 1)
"""Half the turn of the heading from this frame to the next, radians (one column)."""
ROOT_LINEAR_VELOCITY = slice(1, 3)
"""Step of the pelvis along x and z to the next frame, seen from the next frame's heading, metres."""
ROOT_HEIGHT = slice(3, 4)
"""Height of the pelvis, metres."""
JOINT_POSITIONS = slice(4, 67)
"""Joints 1 to 21 relative to the ground point under the pelvis, seen from the heading; y is height. Metres."""
JOINT_ROTATIONS = slice(67, 193)
"""Rotations of joints 1 to 21: the first two columns of each matrix, one after the other."""
JOINT_VELOCITIES = slice(193, 259)
"""Steps of all 22 joints to the next frame, seen from this frame's heading, metres."""
FOOT_CONTACTS = slice(259, 263)
"""1 where left ankle, left foot, right ankle, right foot move less than the contact threshold, else 0."""

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
"""The seven blocks in the order of their columns; each shares one standard deviation."""

Mode = Literal["continuous", "reference"]
"""``reference`` reproduces the yaw that the original loses when the heading passes the opposite of its start;
``continuous`` loses none. Without such a passage the two are equal."""

CONTACT_JOINTS = (Joint.LEFT_ANKLE, Joint.LEFT_FOOT, Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT)
CONTACT_THRESHOLD = 0.002
"""Squared step of a joint below which it touches the ground, square metres; no height is tested."""

_HEADING_SIGMA = 20.0
"""Standard deviation of the Gaussian that smooths the heading, frames."""
HEADING_RADIUS = 80
"""Frames on each side that it reaches: four standard deviations."""


def heading_kernel() -> np.ndarray:
    """The 161 weights that smooth the heading over time; their sum is 1."""
    frames = np.arange(-HEADING_RADIUS, HEADING_RADIUS + 1)
    weights = np.exp(-0.5 * (frames / _HEADING_SIGMA) ** 2)
    return weights / weights.sum()


_X, _Y, _Z = np.eye(3)
REST_DIRECTIONS = np.array(
    [0 * _X, _X, -_X, _Y, -_Y, -_Y, _Y, -_Y, -_Y, _Y, _Z, _Z, _Y, _X, -_X, _Z, -_Y, -_Y, -_Y, -_Y, -_Y, -_Y]
)
"""Direction of the bone that ends in each joint (22, 3), in the rest pose; zero for the pelvis."""

BONE_LENGTHS = np.array(
    [0.0, 0.103100181, 0.109867722, 0.131602719, 0.393589228, 0.390126109, 0.14316383, 0.432214946, 0.425707549,
     0.057362135, 0.143381089, 0.149540886, 0.219349399, 0.137450144, 0.143360779, 0.103108704, 0.131557733,
     0.123003282, 0.256924629, 0.263132274, 0.266010493, 0.269717634]
)  # fmt: skip
"""Lengths (22,) of the uniform skeleton's bones by the joint in which they end, metres."""

REST_OFFSETS = REST_DIRECTIONS * BONE_LENGTHS[:, None]
"""The uniform skeleton (22, 3): rest offset of each joint from its parent, metres."""


def _rotation_parents() -> tuple[int, ...]:
    """Joint whose rotation each joint's rotation is relative to; the two arm chains start again from the root."""
    parents = [0] * N_JOINTS
    for chain in CHAINS:
        for place in range(2, len(chain)):
            parents[chain[place]] = chain[place - 1]
    return tuple(parents)


ROTATION_PARENTS: tuple[int, ...] = _rotation_parents()
"""0 stands for the root's heading."""


def _half_turn_midways() -> np.ndarray:
    """Choose the direction half-way of the turn of a bone that is exactly opposite to its rest direction.

    Bones along x and y turn about z, those along z about y; the half-way direction is orthogonal to both.
    """
    axes = np.where(np.abs(REST_DIRECTIONS[:, 2:]) > 0, _Y, _Z)
    return np.cross(axes, REST_DIRECTIONS)


HALF_TURN_MIDWAYS = _half_turn_midways()

REFLECTION_SIGNS = 2.0 * np.abs(REST_DIRECTIONS) - 1.0
"""Diagonal (22, 3) of 2 u u' - 1 for the rest direction u, used to write the shortest rotation as two reflections."""

OPPOSITE = 1e-6
"""Length of (rest direction + bone direction) below which a bone counts as exactly opposite to its rest direction."""
