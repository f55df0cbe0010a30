"""The objects of a HOT3D recording: their tracks, boxes and meshes (docs/specification/hot3d.md#files)."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Int

from prbench.bounded import require_size
from prbench.errors import InputFileError
from prbench.readers.files import (
    column_vectors,
    decode_json,
    missing_file,
    read_columns,
    require_increasing,
    require_poses,
)
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import layout
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


def read_instances(path: Path) -> dict[str, Instance]:
    """Names by uid.

    Raises:
        InputFileError: if the file is missing, damaged or lacks a key.
    """
    return decode_json(path, _INSTANCES)


def _read_pose_rows(path: Path) -> dict[str, hot3d.PoseRows]:
    """Poses of every body of the file, by uid; uids stay text.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, a pose is no pose, or the clock of a body
            stands still (a repeated row) or runs backwards.
    """
    numbers = dict.fromkeys((*hot3d.POSITION, *hot3d.ROTATION), float)
    table = read_columns(path, {hot3d.OBJECT_ID: str, hot3d.TIME: int, **numbers})
    if len(table) == 0:
        raise InputFileError(
            path,
            "",
            expected="rows of poses",
            found="none",
            remedy="metadata.json says that this ground truth is there; download the recording again.",
        )
    position = column_vectors(table, hot3d.POSITION)
    rotation = column_vectors(table, hot3d.ROTATION)
    require_poses(path, position, rotation)
    encoded = table[hot3d.OBJECT_ID].combine_chunks().dictionary_encode()
    codes = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    times = table[hot3d.TIME].to_numpy()
    order = np.argsort(codes, kind="stable")
    _require_clock(path, codes[order], times[order], order)
    bounds = np.searchsorted(codes[order], np.arange(len(encoded.dictionary) + 1))
    return {
        uid: hot3d.PoseRows(times[rows], position[rows], rotation[rows])
        for uid, rows in zip(encoded.dictionary.to_pylist(), np.split(order, bounds[1:-1]), strict=True)
    }


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


def _require_clock(
    path: Path, codes: Int[np.ndarray, " n"], times: Int[np.ndarray, " n"], order: Int[np.ndarray, " n"]
) -> None:
    """Refuse a body whose rows are not in the order of time; rows are grouped by body here."""
    backwards = np.flatnonzero((np.diff(codes) == 0) & (np.diff(times) <= 0))
    if backwards.size:
        earlier = backwards[0]
        later = backwards[0] + 1
        require_increasing(path, times[earlier : later + 1], unit="ns", first=int(order[later]) + 1)
