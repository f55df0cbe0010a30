"""Gaze rays against axis-aligned boxes: the slab test and the near miss (*Prime and Reach*, equations 4 to 7).

Both functions test every ray against every box at once. Degenerate cases are defined, never NaN:

* A direction component of zero leaves that slab without constraint when the origin lies inside it (borders
  included), and misses the box when it does not.
* A box of zero size is a point; equation 4 asks for ``t_near < t_far``, so a point is never *hit*, but it can be
  nearly missed, at the distance between the point and the ray.
* A closest point inside the box, the centre included, is at distance 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class SlabHits:
    """Result of the slab test for n rays and m boxes."""

    near: Float[np.ndarray, "n m"]
    """Distance along the ray to the last slab entered; negative if the origin lies beyond it, inf for a miss."""
    far: Float[np.ndarray, "n m"]
    """Distance along the ray to the first slab left; -inf for a miss."""
    hit: Bool[np.ndarray, "n m"]
    """``near < far`` and ``far >= 0`` (equation 4)."""


def slab_test(
    origins: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    box_min: Float[np.ndarray, "m 3"],
    box_max: Float[np.ndarray, "m 3"],
) -> SlabHits:
    """Intersect n rays with m axis-aligned boxes (equation 4).

    Args:
        origins: Ray origins, metres; same frame as the boxes.
        directions: Unit directions; their length is the unit of the returned distances.
        box_min: Lower corners of the boxes.
        box_max: Upper corners of the boxes.
    """
    n = len(origins)
    m = len(box_min)
    near = np.full((n, m), -np.inf)
    far = np.full((n, m), np.inf)
    entry = np.empty((n, m))
    leave = np.empty((n, m))
    for axis in range(3):
        origin = origins[:, axis, None]
        direction = directions[:, axis, None]
        parallel = direction[:, 0] == 0
        # Rows with a direction of 0 are overwritten below; here they only must not divide by it.
        inverse = 1.0 / np.where(direction == 0, 1.0, direction)
        np.subtract(box_min[None, :, axis], origin, out=entry)
        np.subtract(box_max[None, :, axis], origin, out=leave)
        inside = (entry[parallel] <= 0) & (leave[parallel] >= 0)
        entry *= inverse
        leave *= inverse
        backwards = direction[:, 0] < 0
        if backwards.any():
            entry[backwards], leave[backwards] = leave[backwards], entry[backwards]
        if parallel.any():
            entry[parallel] = np.where(inside, -np.inf, np.inf)
            leave[parallel] = np.where(inside, np.inf, -np.inf)
        np.maximum(near, entry, out=near)
        np.minimum(far, leave, out=far)
    return SlabHits(near, far, (near < far) & (far >= 0))


@dataclass(frozen=True)
class NearMisses:
    """Result of the proximity check for n rays and m boxes."""

    distance: Float[np.ndarray, "n m"]
    """Distance from the ray's closest point to the box, measured towards its centre, metres (delta of equation 7)."""
    along: Float[np.ndarray, "n m"]
    """Position of the closest point on the ray (t_closest of equation 5); negative behind the origin."""

    def within(self, tolerance: float) -> Bool[np.ndarray, "n m"]:
        """Near misses: ``distance <= tolerance`` and the closest point in front of the origin (equation 7)."""
        return (self.distance <= tolerance) & (self.along >= 0)


def near_miss(
    origins: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    box_min: Float[np.ndarray, "m 3"],
    box_max: Float[np.ndarray, "m 3"],
) -> NearMisses:
    """Compute how closely n rays pass m boxes (equations 5 to 7).

    The closest point is the one nearest to the box *centre*; from it a second ray runs to the centre, and the distance
    is the stretch of that ray before it enters the box.

    Args:
        origins: Ray origins, metres; same frame as the boxes.
        directions: Unit directions.
        box_min: Lower corners.
        box_max: Upper corners.
    """
    centre = (box_min + box_max) / 2
    half = (box_max - box_min) / 2
    offset = centre[None] - origins[:, None]  # (n, m, 3)
    # Equation 5.
    along = np.einsum("nmk,nk->nm", offset, directions)
    to_centre = offset - along[..., None] * directions[:, None]
    length = np.linalg.norm(to_centre, axis=-1)
    # The ray from the centre towards the closest point leaves the box after min_i half_i / |d_i|; an axis along which
    # it does not move is no constraint.
    component = np.abs(to_centre)
    moving = component > 0
    ratio = np.divide(half[None], component, out=np.full_like(component, np.inf), where=moving).min(axis=-1)
    inside_length = np.where(np.isfinite(ratio), ratio, 0.0) * length
    # Equation 7; a closest point inside the box is at distance 0.
    return NearMisses(np.maximum(length - inside_length, 0.0), along)
