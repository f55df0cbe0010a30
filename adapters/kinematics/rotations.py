"""Rotation matrices: as the six numbers of their first two rows, and the shortest one between two directions."""

from __future__ import annotations

import torch
from jaxtyping import Float

_SHORTEST = 1e-12  # of a vector that is made a unit vector; keeps zero vectors, and their gradients, finite
_OPPOSITE = 1e-6  # length of the sum of two unit vectors below which they count as opposite


def rows_of(matrices: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 6"]:
    """The first two **rows**, one after the other (DART and WANDR; HumanML3D takes columns)."""
    return matrices[..., :2, :].flatten(-2)


def matrices_of(rows: Float[torch.Tensor, "*batch 6"]) -> Float[torch.Tensor, "*batch 3 3"]:
    """Rotation matrices of six numbers that may be no rotation: Gram-Schmidt, the first row keeps its direction."""
    first, second = rows[..., :3], rows[..., 3:]
    first = unit(first)
    second = unit(second - (first * second).sum(-1, keepdim=True) * first)
    return torch.stack((first, second, torch.linalg.cross(first, second)), -2)


def orthonormalised(matrices: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 3 3"]:
    """The matrices without what rounding has added to them, through the six numbers."""
    return matrices_of(rows_of(matrices))


def shortest_rotations(
    axes: Float[torch.Tensor, "bones 3"],
    half_turn_midways: Float[torch.Tensor, "bones 3"],
    directions: Float[torch.Tensor, "*batch bones 3"],
) -> Float[torch.Tensor, "*batch bones 3 3"]:
    """The rotations by the smallest angle that turn fixed axes onto directions.

    Each is the reflection at the axis a followed by the one at the direction m half-way between both:
    ``(2 m m' - 1)(2 a a' - 1)``. Where the two are opposite, m is not defined and a fixed one is taken.

    Args:
        axes: Unit vectors along a coordinate axis, either way.
        half_turn_midways: Unit vectors orthogonal to them, which decide about half turns.
        directions: Unit vectors.
    """
    between = directions + axes
    opposite = between.square().sum(-1, keepdim=True) < _OPPOSITE**2
    midway = unit(torch.where(opposite, half_turn_midways, between))
    turned = 2 * midway[..., :, None] * midway[..., None, :] - torch.eye(3).to(midway)
    return turned * (2 * axes.abs() - 1)[:, None, :]


def unit(vectors: Float[torch.Tensor, "*batch 3"]) -> Float[torch.Tensor, "*batch 3"]:
    """Unit vectors; a zero vector stays zero and has no gradient of NaN."""
    square = vectors.square().sum(-1, keepdim=True)
    return vectors * torch.where(square > _SHORTEST**2, square, 1.0).rsqrt()
