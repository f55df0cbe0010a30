"""Rays against triangle meshes: trimesh as the base, Open3D's ``RaycastingScene`` as the fast path."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import MissingExtraError


@runtime_checkable
class RayCaster(Protocol):
    """One mesh, prepared for rays; everything in the mesh's own frame, metres."""

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None: ...

    def first_hit(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """Distance along each ray (unit directions) to the first triangle, seen from either side; inf for none."""
        ...


class TrimeshCaster:
    """Exact in double precision; needs nothing but the core packages."""

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        import trimesh
        from trimesh.ray.ray_triangle import RayMeshIntersector

        # Named, because `mesh.ray` is another program where Embree happens to be installed.
        self._rays = RayMeshIntersector(trimesh.Trimesh(vertices, faces, process=False))

    def first_hit(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """See :meth:`RayCaster.first_hit`."""
        distance = np.full(len(origins), np.inf)
        if len(origins) == 0:
            return distance
        places, ray, _ = self._rays.intersects_location(origins, directions, multiple_hits=True)
        np.minimum.at(distance, ray, np.linalg.norm(np.reshape(places, (-1, 3)) - origins[ray], axis=1))
        return distance


class Open3dCaster:
    """Single precision, and the quicker the larger the mesh."""

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        self._open3d = _import_open3d()
        self._scene = self._open3d.t.geometry.RaycastingScene()
        tensor = self._open3d.core.Tensor
        self._scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))

    def first_hit(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """See :meth:`RayCaster.first_hit`."""
        rays = np.hstack([origins, directions]).astype(np.float32)
        hits = self._scene.cast_rays(self._open3d.core.Tensor(rays))
        return hits["t_hit"].numpy().astype(np.float64)


CASTERS: Mapping[str, type[RayCaster]] = MappingProxyType({"trimesh": TrimeshCaster, "open3d": Open3dCaster})
"""By name of the option."""


def require_caster(name: str) -> None:
    """Refuse a ray caster whose package is not installed, before anything is read.

    Raises:
        MissingExtraError: with the line that installs it.
    """
    if name == "open3d":
        _import_open3d()


def _import_open3d() -> Any:
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        raise MissingExtraError("open3d", "open3d", "--ray-caster open3d") from error
