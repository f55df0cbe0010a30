"""Rays against triangle meshes: our own NumPy as the base, Open3D's ``RaycastingScene`` as the fast path."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from prbench.curation.triangle_tree import TriangleTree
from prbench.errors import MissingExtraError


@runtime_checkable
class RayCaster(Protocol):
    """One mesh, prepared for rays; everything in the mesh's own frame, metres."""

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None: ...

    def first_hit(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        reach: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """Distance along each ray (unit directions) to the first triangle, from either side; inf for none in reach."""
        ...


class Open3dCaster:
    """Single precision, and the quicker the larger the mesh."""

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        self._open3d = _import_open3d()
        self._scene = self._open3d.t.geometry.RaycastingScene()
        tensor = self._open3d.core.Tensor
        self._scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))

    def first_hit(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        reach: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """See :meth:`RayCaster.first_hit`."""
        rays = np.hstack([origins, directions]).astype(np.float32)
        hits = self._scene.cast_rays(self._open3d.core.Tensor(rays))
        distance = hits["t_hit"].numpy().astype(np.float64)
        return np.where(distance < reach, distance, np.inf)


CASTERS: Mapping[str, type[RayCaster]] = MappingProxyType({"numpy": TriangleTree, "open3d": Open3dCaster})
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
