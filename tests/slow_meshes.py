"""Closest points on a mesh by a loop over its triangles: the oracle of :mod:`prbench.geometry.shapes`."""

from __future__ import annotations

import numpy as np
import trimesh

from prbench.geometry.shapes import TriangleMesh


class SlowMesh(TriangleMesh):
    """Answers what :class:`prbench.geometry.shapes.TriangleMesh` answers."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._triangles = vertices[faces]

    def distance(self, points: np.ndarray) -> np.ndarray:
        """By trimesh's closest point on a triangle, for every triangle."""
        nearest = np.full(len(points), np.inf)
        for triangle in self._triangles:
            closest = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(points), 3, 3)), points)
            nearest = np.minimum(nearest, np.linalg.norm(points - closest, axis=1))
        return nearest
