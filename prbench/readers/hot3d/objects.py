"""The objects of a HOT3D recording: their tracks, boxes and meshes (docs/specification/hot3d.md#files)."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from prbench.errors import InputFileError
from prbench.files.bounded import require_size
from prbench.readers.files import decode_json, missing_file
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import layout
from prbench.readers.hot3d.format import ObjectMesh
from prbench.readers.pose_table import read_poses_by_body

_METRES = 7
"""Decimals: float32 millimetres carry no more."""


class _Accessor(msgspec.Struct):
    count: int


class _Description(msgspec.Struct):
    """The JSON part of a binary glTF, as far as it declares sizes."""

    accessors: list[_Accessor] = []


class Instance(msgspec.Struct):
    """One entry of ``instance.json``."""

    instance_name: str
    instance_type: str


_INSTANCES = msgspec.json.Decoder(dict[str, Instance])


def read_objects(found: RecordingFiles) -> tuple[tuple[hot3d.Hot3dObject, ...], tuple[str, ...]]:
    """All objects that a recording tracks, by uid, and remarks.

    An object without a model keeps its poses; without a name it is called by its uid.

    Raises:
        InputFileError: for a missing or damaged file, a pose that is no pose, a clock that runs backwards, no object.
    """
    path = found.require(layout.OBJECTS, hot3d.OBJECTS_FILE)
    rows = _read_pose_rows(path)
    instances = read_instances(found.require(layout.INSTANCES, f"../assets/{hot3d.INSTANCES_FILE}"))
    held = [uid for uid in sorted(rows) if uid not in instances or instances[uid].instance_type == hot3d.LIBRARY_OBJECT]
    if not held:
        raise InputFileError(path, hot3d.OBJECT_ID, expected="objects", found="headsets only")
    models = {uid: found.path(f"{layout.MODEL_PREFIX}{uid}") for uid in held}
    objects = tuple(
        hot3d.Hot3dObject(
            object_id=uid,
            name=instances[uid].instance_name if uid in instances else uid,
            rows=rows[uid],
            mesh=None if model is None else read_glb(model),
        )
        for uid, model in models.items()
    )
    nameless = [uid for uid in held if uid not in instances]
    return objects, (f"objects without a name in {hot3d.INSTANCES_FILE}: {', '.join(nameless)}",) if nameless else ()


def _read_pose_rows(path: Path) -> dict[str, hot3d.PoseRows]:
    """Poses of every body of the file, by uid; uids stay text.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, a pose is no pose, or the clock of a body
            stands still (a repeated row) or runs backwards.
    """
    poses = read_poses_by_body(
        path, body={hot3d.OBJECT_ID: str}, time=hot3d.TIME, position=hot3d.POSITION, rotation=hot3d.ROTATION
    )
    if not poses:
        raise InputFileError(
            path,
            "",
            expected="rows of poses",
            found="none",
            remedy="metadata.json says that this ground truth is there; download the recording again.",
        )
    return {uid: hot3d.PoseRows(*rows) for uid, rows in poses.items()}


def read_instances(path: Path) -> dict[str, Instance]:
    """Names by uid.

    Raises:
        InputFileError: if the file is missing, damaged or lacks a key.
    """
    return decode_json(path, _INSTANCES)


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


def read_headset(path: Path) -> hot3d.PoseRows:
    """Poses of the glasses.

    Raises:
        InputFileError: see :func:`_read_pose_rows`; or if the file holds several headsets.
    """
    rows = _read_pose_rows(path)
    if len(rows) > 1:
        raise InputFileError(
            path, hot3d.OBJECT_ID, expected="one headset", found=f"{len(rows)}: {', '.join(sorted(rows)[:3])}"
        )
    return next(iter(rows.values()))
