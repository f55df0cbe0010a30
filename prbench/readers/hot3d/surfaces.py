"""Points spread over a triangle mesh, so that distances to its surface are distances to the nearest of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

_FINEST = 64
"""Most pieces into which an edge is cut."""


def surface_points(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], *, spacing: float
) -> Float[np.ndarray, "k 3"]:
    """A regular grid on every triangle, corners and edges included; deterministic.

    No place of a triangle is further from a grid point than ``spacing / sqrt(3)``, as long as no edge is longer than
    64 times the spacing. Points closer than a quarter of the spacing are merged.

    Args:
        vertices: Metres.
        faces: Corners of the triangles.
        spacing: Largest distance between neighbours along an edge, metres.
    """
    corners = vertices[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    pieces = np.clip(np.ceil(edges / spacing), 1, _FINEST).astype(np.int64)
    points = [
        np.einsum("pk,fkc->fpc", _barycentric(int(count)), corners[pieces == count]).reshape(-1, 3)
        for count in np.unique(pieces)
    ]
    merged = np.concatenate(points)
    _, first = np.unique(np.rint(merged / (spacing / 4)).astype(np.int64), axis=0, return_index=True)
    return merged[np.sort(first)]


def _barycentric(pieces: int) -> Float[np.ndarray, "p 3"]:
    """Weights of the corners at all grid points of a triangle whose edges are cut into ``pieces``."""
    first, second = np.meshgrid(np.arange(pieces + 1), np.arange(pieces + 1), indexing="ij")
    inside = first + second <= pieces
    first, second = first[inside], second[inside]
    return np.column_stack([first, second, pieces - first - second]) / pieces
