"""Rays and closest points on triangle meshes, by Open3D's ``RaycastingScene`` (extra ``open3d``).

Open3D computes in float32, which erred by up to 28 µm in a room of 8 m. It is therefore asked for the triangle
alone: the distance to that triangle is computed from its corners in float64. ``benchmarks/speed/bench_meshes.py``
measures the error of both, and the speed beside other libraries.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import MissingExtraError, UnloadableExtraError


def import_open3d(purpose: str) -> Any:
    """Import Open3D.

    Args:
        purpose: What needs it, for the message.

    Raises:
        MissingExtraError: if it is not installed, with the line that installs it.
        UnloadableExtraError: if it is installed and cannot be loaded.
    """
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise MissingExtraError("open3d", "open3d", purpose) from error
    except ImportError as error:
        # The wheels expect some libraries of a desktop system, which images for servers leave out.
        remedy = "On Debian and Ubuntu: apt-get install libusb-1.0-0 libgl1 libgomp1 libx11-6"
        raise UnloadableExtraError("open3d", purpose, str(error), remedy) from error


class TriangleMesh:
    """One triangle mesh, prepared for rays and closest points.

    Args:
        vertices: Corners, metres. Rays and points are given in the same frame.
        faces: Three rows of ``vertices`` for each triangle.

    Raises:
        MissingExtraError: if Open3D is not installed.
    """

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        open3d = import_open3d("measuring distances to meshes")
        self._tensor = open3d.core.Tensor
        self._corners = vertices.astype(np.float64)[faces]
        # float32 is finest around the origin, so the mesh is moved there.
        self._centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._single(vertices), self._tensor(faces.astype(np.uint32)))

    def first_hit(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        reach: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """Distance along each ray to the first triangle, seen from either side.

        Args:
            origins: Where the rays begin.
            directions: Unit vectors.
            reach: How far each ray goes, metres.

        Returns:
            Metres; inf where nothing is in reach.
        """
        rays = np.hstack([origins - self._centre, directions]).astype(np.float32)
        found = self._scene.cast_rays(self._tensor(rays))
        single = found["t_hit"].numpy().astype(np.float64)
        hit = np.flatnonzero(np.isfinite(single))
        corners = self._corners[found["primitive_ids"].numpy()[hit]]
        distance = np.full(len(origins), np.inf)
        distance[hit] = _to_plane(corners, origins[hit], directions[hit], otherwise=single[hit])
        return np.where(distance < reach, distance, np.inf)

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distance of each point to the closest point of the surface, metres; points inside a body are not negative."""
        found = self._scene.compute_closest_points(self._single(points))
        corners = self._corners[found["primitive_ids"].numpy()]
        first, second = found["primitive_uvs"].numpy().astype(np.float64).T[..., None]
        closest = corners[:, 0] * (1 - first - second) + corners[:, 1] * first + corners[:, 2] * second
        return np.linalg.norm(points - closest, axis=1)

    def _single(self, points: Float[np.ndarray, "n 3"]) -> Any:
        """Points around the mesh's centre as a float32 tensor."""
        return self._tensor((points - self._centre).astype(np.float32))


def _to_plane(
    corners: Float[np.ndarray, "n 3 3"],
    origins: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    *,
    otherwise: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Distance along each ray to its triangle's plane; ``otherwise`` where the ray lies in the plane."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    speed = np.einsum("nc,nc->n", directions, normal)
    height = np.einsum("nc,nc->n", corners[:, 0] - origins, normal)
    return np.divide(height, speed, out=otherwise.copy(), where=speed != 0)
