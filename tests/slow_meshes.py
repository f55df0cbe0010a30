"""Rays and closest points on a mesh by a loop over its triangles: the oracle of :mod:`prbench.geometry.shapes`."""

from __future__ import annotations

import numpy as np
import trimesh

from prbench.geometry.shapes import TriangleMesh


class SlowMesh(TriangleMesh):
    """Answers what :class:`prbench.geometry.shapes.TriangleMesh` answers."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._triangles = vertices[faces]

    def first_hit(self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Each triangle and all rays as systems of three equations."""
        distance = np.full(len(origins), np.inf)
        for a, b, c in self._triangles:
            sides = np.broadcast_to(np.stack([b - a, c - a], axis=1), (len(origins), 3, 2))
            systems = np.concatenate([-directions[:, :, None], sides], axis=2)
            solvable = np.abs(np.linalg.det(systems)) > 1e-12
            along, u, v = np.linalg.solve(systems[solvable], (origins[solvable] - a)[..., None])[..., 0].T
            inside = (along > 0) & (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12)
            met = np.flatnonzero(solvable)[inside]
            distance[met] = np.minimum(distance[met], along[inside])
        return np.where(distance < reach, distance, np.inf)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """By trimesh's closest point on a triangle, for every triangle."""
        nearest = np.full(len(points), np.inf)
        for triangle in self._triangles:
            closest = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(points), 3, 3)), points)
            nearest = np.minimum(nearest, np.linalg.norm(points - closest, axis=1))
        return nearest
