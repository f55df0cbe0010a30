"""Object models: binary glTF, in millimetres below scaled, turned and shifted nodes."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from prbench.bounded import require_size
from prbench.errors import InputFileError
from prbench.readers.files import missing_file
from prbench.readers.hot3d.format import ObjectMesh

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
        _require_plausible_counts(path)
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


def _require_plausible_counts(path: Path) -> None:
    """Refuse arrays that declare more entries than the file has bytes, before the parser makes room for them.

    Accessors without values in the file are zeros, so that a few bytes could declare any number of corners.
    """
    content = path.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    description = msgspec.json.decode(content[20 : 20 + length], type=_Description)
    largest = max((accessor.count for accessor in description.accessors), default=0)
    if largest > len(content):
        raise InputFileError(
            path,
            "accessors",
            expected=f"at most {len(content):,} entries, one a byte of the file",
            found=f"{largest:,}",
            remedy="Download the object library again.",
        )


class _Accessor(msgspec.Struct):
    count: int


class _Description(msgspec.Struct):
    """The JSON part of a binary glTF, as far as it declares sizes."""

    accessors: list[_Accessor] = []
