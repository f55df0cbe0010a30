"""Objects of a HOT3D recording: names from the library, poses, models."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.errors import InputFileError
from prbench.readers.files import decode_json
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import layout
from prbench.readers.hot3d.meshes import read_glb
from prbench.readers.hot3d.poses import read_pose_rows


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
    rows = read_pose_rows(path)
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
