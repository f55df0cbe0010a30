"""Finds another axis than +Y that points up."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from prbench.checking.doctor.anatomy import body_up, front, left_of_hips, sidedness
from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, no_finding

_NAMES = "xyz"
_UP = np.array([0.0, 1.0, 0.0])
_CLEAR = 35.0  # degrees between bodies and an axis, below which it is certain
_TILTED = 25.0  # degrees from +Y that people do not lean


@dataclass(frozen=True)
class _Exchange:
    """New axis i is old axis ``axes[i]`` times ``signs[i]``."""

    axes: tuple[int, int, int]
    signs: tuple[int, int, int]

    @property
    def mirrors(self) -> bool:
        """True if it turns a right-handed world into a left-handed one."""
        return bool(np.linalg.det(self.matrix) < 0)

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3); new = matrix @ old."""
        matrix = np.zeros((3, 3))
        matrix[range(3), self.axes] = self.signs
        return matrix

    @property
    def plain(self) -> bool:
        """True if only two axes are exchanged, or one is negated: the usual slips that mirror the world."""
        moved = sum(axis != place for place, axis in enumerate(self.axes))
        negated = sum(sign < 0 for sign in self.signs)
        return (moved, negated) in {(2, 0), (0, 1)}

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (…, 3) with exchanged axes, without rounding."""
        return points[..., list(self.axes)] * np.array(self.signs, dtype=points.dtype)

    def __str__(self) -> str:
        return f"({', '.join(('-' if sign < 0 else '') + _NAMES[axis] for axis, sign in zip(self.axes, self.signs))})"

    def as_code(self) -> str:
        """An expression for the new joints."""
        parts = (f"{'-' if sign < 0 else ''}joints[..., {axis}]" for axis, sign in zip(self.axes, self.signs))
        return f"np.stack([{', '.join(parts)}], axis=-1)"


def examine_up_axis(motion_set: MotionSet) -> Finding:
    """Find the axis along which bodies stand, from their ankles to their heads."""
    poses = motion_set.poses()
    up = body_up(poses).mean(axis=0)
    name, axis, angle = _nearest_axis(up)
    evidence = (
        f"bodies (ankles to head) point along ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}), {angle:.0f} degrees from {name}"
    )
    if np.linalg.norm(up) < 0.3:
        return no_finding(motion_set)  # no common direction
    if name == "+y":
        return no_finding(motion_set) if angle < _TILTED else Finding((_leaning(evidence),), motion_set)
    # Handedness shows in the front and the left side together, whichever axis points up.
    mirrored = float(sidedness(poses, left_of_hips(poses)).mean()) < -0.5
    exchange = _best(motion_set, axis, mirrored=mirrored)
    if mirrored and not exchange.plain:  # two faults: the second is found later
        mirrored = False
        exchange = _best(motion_set, axis, mirrored=False)
    cause = f"{name} points up instead of +y"
    if mirrored:
        cause += f", and the world is mirrored as well: axes were exchanged or negated to {exchange} without a turn"
    remedy = f"Turn the axes, (x, y, z) to {exchange}: {exchange.as_code()}."
    if str(exchange) == "(x, z, -y)":
        remedy += " prbench.geometry.axes.y_up does this."
    elif not mirrored:
        remedy += f" Or prbench.representation.converters.to_y_up(joints, up='{name.lstrip('+')}'), then canonicalise."
    found = Diagnosis("up-axis", angle < _CLEAR, evidence, cause, remedy)
    return Finding((found,), motion_set.changed(exchange))


def _best(motion_set: MotionSet, axis: np.ndarray, *, mirrored: bool) -> _Exchange:
    """Return the exchange that takes ``axis`` to +Y and leaves first poses facing +Z most nearly."""
    facing = front(motion_set.first_poses()).mean(axis=0)
    fitting = [each for each in _EXCHANGES if (each(axis) == _UP).all() and each.mirrors is mirrored]
    # Rounded, so that equally good turns are told apart by being plain and not by noise.
    return max(fitting, key=lambda each: (round(float(each(facing)[2]), 1), each.plain, each.signs))


def _leaning(evidence: str) -> Diagnosis:
    cause = "the world is tilted (gravity was not estimated, or a camera's frame was kept), or people lean or lie"
    return Diagnosis("up-axis", False, evidence, cause, "Turn the world so that gravity points along -y.")


def _nearest_axis(direction: np.ndarray) -> tuple[str, np.ndarray, float]:
    """Name and unit vector of the signed axis next to a direction, and the angle between them in degrees."""
    axis = int(np.abs(direction).argmax())
    sign = 1.0 if direction[axis] >= 0 else -1.0
    vector = np.zeros(3)
    vector[axis] = sign
    cosine = float(direction @ vector / max(float(np.linalg.norm(direction)), 1e-12))
    return f"{'+' if sign > 0 else '-'}{_NAMES[axis]}", vector, float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))


_EXCHANGES = tuple(
    _Exchange((first, second, third), (one, two, three))
    for first, second, third in permutations(range(3))
    for one, two, three in product((1, -1), repeat=3)
)
