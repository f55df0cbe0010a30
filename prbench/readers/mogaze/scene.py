"""``scene.xml`` of MoGaze: names and meshes of the tracked bodies.

Sources: docs/specification/mogaze.md#files and docs/specification/mogaze.md#objects.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, require_size
from prbench.limits import HARMLESS_SIZE
from prbench.readers.mogaze import format as mogaze

_MOST_DIGITS = 19  # of the id of a body


@dataclass(frozen=True)
class SceneBody:
    """One body of the scene."""

    name: str
    mesh: Path | None
    """None where the scene names none, or none of that name lies in the dataset's folder."""


@foreign_input()
def read_scene(path: Path) -> dict[int, SceneBody]:
    """Bodies by id.

    Raises:
        InputFileError: if the file is no XML, or a body lacks id or name.
    """
    try:
        require_size(path, largest=HARMLESS_SIZE)
        root = ET.parse(path).getroot()
    except ET.ParseError as error:
        raise InputFileError(
            path, "", expected="XML", found=str(error), remedy="Copy or download the file again."
        ) from error
    bodies = {}
    for number, entry in enumerate(root.iter("body"), start=1):
        key = entry.get("id", "")
        name = entry.get("name", "").strip()
        if not key.isdecimal() or len(key) > _MOST_DIGITS or not name:
            raise InputFileError(
                path,
                f"body {number}",
                expected="an integer id and a name",
                found=f"id '{key}' and name '{name}'",
                remedy="Copy or download the file again; without it the bodies get their names by their order.",
            )
        mesh = entry.find("meshfile")
        source = "" if mesh is None else mesh.get("src", "")
        bodies[int(key)] = SceneBody(name, find_mesh(path.parent, source) if source else None)
    return bodies


def find_mesh(folder: Path, source: str) -> Path | None:
    """The mesh that a scene names: relative to the parent of the dataset's folder, to the folder, or by its base name.

    A path that leads out of the dataset's folder is never followed.

    Args:
        folder: The dataset's folder, in which ``scene.xml`` lies.
        source: What stands in ``scene.xml``, for example ``mogaze/meshfiles/cup.obj``.
    """
    written = PurePosixPath(source.replace("\\", "/"))
    for candidate in (folder.parent / written, folder / written, folder / mogaze.MESH_FOLDER / written.name):
        # Asked first, because following links takes ten times as long, and few candidates are there.
        if candidate.is_file() and (place := candidate.resolve()).is_relative_to(folder.resolve()):
            return place
    return None


def read_mesh(path: Path) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices (metres, in the frame of the body) and triangles of a mesh.

    Raises:
        InputFileError: if the file holds no triangles.
    """
    status = path.stat()
    return _read_mesh(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=64)
def _read_mesh(path: Path, _size: int, _changed: int) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    import trimesh  # late: 0.3 s that copies without meshes need not wait for

    try:
        require_size(path)
        mesh = trimesh.load_mesh(path, process=False)
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except (ValueError, IndexError, KeyError, AttributeError, TypeError) as error:
        raise _no_mesh(path, f"'{error}'") from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise _no_mesh(path, f"{len(faces)} triangles and {len(vertices)} corners")
    return vertices, faces


def _no_mesh(path: Path, found: str) -> InputFileError:
    return InputFileError(
        path,
        "",
        expected="a mesh of triangles",
        found=found,
        remedy="Copy or download the file again, or remove it: the size of the object is then taken from a table.",
    )
