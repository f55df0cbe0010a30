"""From the canonical world with Y up to the worlds with Z up that DART and WANDR live in, and back: no rounding.

A standing body that faces +Z (Y up), its left side on +X, comes to face +y with its right side on +x in DART's world,
and to face -y with its left side on +x in WANDR's.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float


@dataclass(frozen=True)
class World:
    """A world with Z up, by the axes (0, 1, 2) that its points have in the world with Y up, and their signs."""

    axes: tuple[int, int, int]
    signs: tuple[float, float, float]

    def from_y_up(self, vectors: Float[torch.Tensor, "*batch 3"]) -> Float[torch.Tensor, "*batch 3"]:
        """Points or directions given with Y up."""
        return vectors[..., self.axes] * vectors.new_tensor(self.signs)

    def to_y_up(self, vectors: Float[torch.Tensor, "*batch 3"]) -> Float[torch.Tensor, "*batch 3"]:
        """The inverse of :meth:`from_y_up`."""
        back = tuple(self.axes.index(axis) for axis in range(3))
        return vectors[..., back] * vectors.new_tensor([self.signs[place] for place in back])


DART = World(axes=(0, 2, 1), signs=(-1.0, 1.0, 1.0))
"""docs/specification/dart.md#noise-optimisation: (x, y, z) with Y up is (-x, z, y) here, and the other way round."""
WANDR = World(axes=(0, 2, 1), signs=(1.0, -1.0, 1.0))
"""docs/specification/wandr.md#inference: (x, y, z) here is (x, z, -y) with Y up."""
