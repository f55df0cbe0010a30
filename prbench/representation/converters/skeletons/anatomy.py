"""Joints that a source does not have, from those that it has, with the proportions of the 22-joint skeleton.

The ratios are means of two bodies: the mean pose of HumanML3D (the public ``Mean.npy``), and the proportions of the
procedural people. Unit is the trunk, from the middle of the hips to the middle of the shoulders, about 0.53 m in an
adult. What each costs is measured in ``docs/wrapping.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from prbench.representation.converters.skeletons.expressions import AXES, Expression, parse_expression
from prbench.skeleton import N_JOINTS, Joint

NAMES: tuple[str, ...] = tuple(joint.name.lower() for joint in Joint)
"""The 22 joints as maps write them."""

LIMBS: tuple[Joint, ...] = tuple(
    Joint[f"{side}_{part}"]
    for part in ("HIP", "KNEE", "ANKLE", "SHOULDER", "ELBOW", "WRIST")
    for side in ("LEFT", "RIGHT")
)
"""What every source must have: without them nothing can be completed."""

_HIPS = "0.5 left_hip + 0.5 right_hip"
_SHOULDERS = "0.5 left_shoulder + 0.5 right_shoulder"
_RULES: Mapping[str, str] = MappingProxyType(
    {
        "pelvis": f"{_HIPS} + 0.19 @up + 0.015 @forward",
        "spine1": f"{_HIPS} + 0.385 @up - 0.03 @forward",
        "spine2": f"{_HIPS} + 0.657 @up + 0.01 @forward",
        "spine3": f"{_HIPS} + 0.767 @up + 0.03 @forward",
        "neck": f"{_SHOULDERS} + 0.172 @up + 0.016 @forward",
        "left_collar": "0.685 left_shoulder + 0.315 right_shoulder - 0.01 @up + 0.01 @forward",
        "right_collar": "0.315 left_shoulder + 0.685 right_shoulder - 0.01 @up + 0.01 @forward",
        "head": "neck + 0.104 @up + 0.119 @forward",
        "left_foot": "left_ankle + 0.244 @ahead - 0.112 @above",
        "right_foot": "right_ankle + 0.244 @ahead - 0.112 @above",
    }
)

COMPLETIONS: Mapping[Joint, Expression] = MappingProxyType(
    {Joint[name.upper()]: parse_expression(rule, NAMES, where=name) for name, rule in _RULES.items()}
)
"""How each joint that may be missing is made from the others, in an order in which each needs only earlier ones."""


def trunk_axes(joints: Float[np.ndarray, "*batch 22 3"]) -> dict[str, Float[np.ndarray, "*batch 3"]]:
    """The axes of expressions, each as long as the trunk; hips and shoulders must be there.

    Args:
        joints: Y up, metres; joints that are still missing may be NaN.
    """
    hips = (joints[..., Joint.LEFT_HIP, :] + joints[..., Joint.RIGHT_HIP, :]) / 2
    shoulders = (joints[..., Joint.LEFT_SHOULDER, :] + joints[..., Joint.RIGHT_SHOULDER, :]) / 2
    trunk = shoulders - hips
    length = np.linalg.norm(trunk, axis=-1, keepdims=True)
    up = _unit(trunk)
    across = joints[..., Joint.LEFT_HIP, :] - joints[..., Joint.RIGHT_HIP, :]
    across = _unit(across) + _unit(joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :])
    left = _unit(across - (across * up).sum(axis=-1, keepdims=True) * up)
    ahead = np.stack([-left[..., 2], np.zeros(left.shape[:-1]), left[..., 0]], axis=-1)
    above = np.broadcast_to(np.array([0.0, 1.0, 0.0]), up.shape)
    directions = (up, np.cross(left, up), left, _unit(ahead), above)
    return {name: direction * length for name, direction in zip(AXES, directions)}


def complete(joints: Float[np.ndarray, "frames 22 3"], missing: tuple[Joint, ...]) -> Float[np.ndarray, "frames 22 3"]:
    """The motion with the missing joints filled in.

    Args:
        joints: Y up, metres; missing ones hold anything.
        missing: Keys of :data:`COMPLETIONS`.
    """
    filled = joints.copy()
    axes = trunk_axes(joints)
    for joint in (joint for joint in COMPLETIONS if joint in missing):
        filled[:, joint] = placed(COMPLETIONS[joint], dict(zip(NAMES, range(N_JOINTS))), filled, axes)
    return filled


def placed(
    expression: Expression,
    columns: Mapping[str, int],
    joints: Float[np.ndarray, "frames joints 3"],
    axes: Mapping[str, Float[np.ndarray, "frames 3"]],
) -> Float[np.ndarray, "frames 3"]:
    """Where an expression points, frame by frame."""
    place = sum(weight * joints[:, columns[name]] for name, weight in expression.joints)
    return np.asarray(place + sum(weight * axes[name] for name, weight in expression.axes))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
