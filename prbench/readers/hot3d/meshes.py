"""Object models: binary glTF, in millimetres below scaled, turned and shifted nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.bounded import require_size
from prbench.errors import InputFileError
from prbench.formats.hot3d import ObjectMesh
from prbench.readers.files import missing_file

_METRES = 7
"""Decimals: float32 millimetres carry no more."""


def read_glb(path: Path) -> ObjectMesh:
    """Read the triangles of a model in the object's frame, metres: node transforms applied, materials left aside.

    Raises:
        InputFileError: if the file is missing, is no binary glTF, or holds no triangles.
    """
    import trimesh  # takes a third of a second, and only models need it

    try:
        require_size(path)
        with open(path, "rb") as file:
            # Whatever a broken file makes the parser stumble over, the user needs its name.
            scene = trimesh.load_scene(file, file_type="glb", process=False, skip_materials=True)
        mesh = scene.to_mesh()
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except (InputFileError, MemoryError):
        raise
    except Exception as error:
        raise InputFileError(
            path,
            "",
            expected="a model in binary glTF",
            found=f"{type(error).__name__}: {str(error)[:120]}",
            remedy="The file may be truncated; download the object library again.",
        ) from error
    vertices = np.round(np.asarray(mesh.vertices, dtype=np.float64), _METRES)
    if len(vertices) == 0 or len(mesh.faces) == 0 or not np.isfinite(vertices).all():
        raise InputFileError(path, "", expected="triangles with finite corners", found=f"{len(mesh.faces)} triangles")
    return ObjectMesh(vertices, np.asarray(mesh.faces, dtype=np.int64))
