"""Joints of another skeleton as expressions, and joints that a source lacks, made from those that it has.

Missing joints follow from the proportions of the 22-joint skeleton. The ratios are means of two bodies: the mean pose
of HumanML3D (the public ``Mean.npy``), and the proportions of the synthetic people. Unit is the trunk, from the middle
of the hips to the middle of the shoulders, about 0.53 m in an adult. What each costs is measured in
``docs/wrapping.md``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from prbench.errors import UsageError, did_you_mean
from prbench.geometry.skeleton import N_JOINTS, Joint

_AXES = ("@up", "@forward", "@left", "@ahead", "@above")
"""Directions of the trunk, each as long as the trunk (middle of the hips to middle of the shoulders): ``@up`` along it,
``@forward`` and ``@left`` across; ``@ahead`` is forward on the ground plane, ``@above`` the vertical."""

_TERM = re.compile(r"(?P<number>\d+\.?\d*|\.\d+)?\s*(?P<name>[@A-Za-z_].*)")
_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Expression:
    """A sum of joints whose weights add up to 1, plus offsets along the axes of the trunk."""

    joints: tuple[tuple[str, float], ...]
    axes: tuple[tuple[str, float], ...] = ()

    def __str__(self) -> str:
        terms = [name if weight == 1 else f"{weight:g} {name}" for name, weight in (*self.joints, *self.axes)]
        return " + ".join(terms).replace("+ -", "- ")


def parse_expression(text: str, known: Iterable[str], *, where: str) -> Expression:
    """``wrist``, ``a + b`` (the mean of two), ``0.6 a + 0.4 b``, ``neck + 0.2 @up - 0.1 @forward``.

    Args:
        text: The expression; spaces around signs.
        known: Names of the source's joints.
        where: What the message begins with.

    Raises:
        UsageError: if a name is unknown (with the nearest one), weights are given to some joints only, or do not add
            up to 1.
    """
    names = list(known)
    joints: list[tuple[str, float | None]] = []
    axes: list[tuple[str, float]] = []
    for sign, term in _signed_terms(text):
        matched = _TERM.fullmatch(term)
        if matched is None:
            raise UsageError(f"{where}: expected joints and numbers such as '0.6 neck + 0.4 head', found '{text}'.")
        name = matched["name"].strip()
        number = matched["number"]
        weight = None if number is None and sign > 0 else sign * float(number or 1)
        if name in names:
            joints.append((name, weight))
        elif name in _AXES:
            axes.append((name, 1.0 if weight is None else weight))
        else:
            raise UsageError(
                f"{where}: unknown joint '{name}'.{did_you_mean(name, [*names, *_AXES])} The source has: "
                f"{', '.join(names)}."
            )
    return Expression(_weighted(joints, text, where), tuple(axes))


def _signed_terms(text: str) -> list[tuple[float, str]]:
    parts = re.split(r"\s+([+-])\s+", text.strip())
    return [(1.0, parts[0])] + [(1.0 if sign == "+" else -1.0, term) for sign, term in zip(parts[1::2], parts[2::2])]


def _weighted(joints: list[tuple[str, float | None]], text: str, where: str) -> tuple[tuple[str, float], ...]:
    given = [weight for _, weight in joints if weight is not None]
    if not given and joints:
        return tuple((name, 1 / len(joints)) for name, _ in joints)
    if len(given) != len(joints) or abs(sum(given) - 1) > _SUM_TOLERANCE:
        raise UsageError(
            f"{where}: expected weights of all joints, which add up to 1, or of none, found '{text}'"
            f" ({sum(given):g} in all)."
        )
    return tuple((name, weight) for name, weight in joints if weight is not None)


NAMES: tuple[str, ...] = tuple(joint.name.lower() for joint in Joint)
"""The 22 joints as maps write them."""

LIMBS: tuple[Joint, ...] = tuple(
    Joint[f"{side}_{part}"]
    for part in ("HIP", "KNEE", "ANKLE", "SHOULDER", "ELBOW", "WRIST")
    for side in ("LEFT", "RIGHT")
)
"""Joints that every source must have: without them nothing can be completed."""

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
"""Maps each joint that may be missing to the rule that makes it; each rule needs only joints of earlier ones."""


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
    return {name: direction * length for name, direction in zip(_AXES, directions)}


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
    """Evaluate an expression, frame by frame."""
    place = sum(weight * joints[:, columns[name]] for name, weight in expression.joints)
    return np.asarray(place + sum(weight * axes[name] for name, weight in expression.axes))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
