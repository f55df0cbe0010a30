"""The 48 ways to write x, y, z: signed exchanges of the three axes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

_NAMES = "xyz"
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Exchange:
    """New axis i is old axis ``axes[i]`` times ``signs[i]``."""

    axes: tuple[int, int, int]
    signs: tuple[int, int, int]

    @property
    def mirrors(self) -> bool:
        """Whether it turns a right-handed world into a left-handed one."""
        return bool(np.linalg.det(self.matrix) < 0)

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3); new = matrix @ old."""
        matrix = np.zeros((3, 3))
        matrix[range(3), self.axes] = self.signs
        return matrix

    @property
    def plain(self) -> bool:
        """Whether only two axes are exchanged, or one is negated: the usual slips that mirror the world."""
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


EXCHANGES = tuple(
    Exchange((first, second, third), (one, two, three))
    for first, second, third in permutations(range(3))
    for one, two, three in product((1, -1), repeat=3)
)


def nearest_axis(direction: np.ndarray) -> tuple[str, np.ndarray, float]:
    """Name and unit vector of the signed axis next to a direction, and the angle between them in degrees."""
    axis = int(np.abs(direction).argmax())
    sign = 1.0 if direction[axis] >= 0 else -1.0
    vector = np.zeros(3)
    vector[axis] = sign
    cosine = float(direction @ vector / max(float(np.linalg.norm(direction)), 1e-12))
    return f"{'+' if sign > 0 else '-'}{_NAMES[axis]}", vector, float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
