"""Objects of an ADT recording: names, boxes and poses (docs/specification/adt.md#files)."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.readers.adt import format as adt
from prbench.readers.files import column_vectors, decode_json, read_columns
from prbench.readers.pose_table import read_poses_by_body


class Instance(msgspec.Struct):
    """One entry of ``instances.json``."""

    instance_id: int
    instance_name: str
    prototype_name: str
    category: str
    motion_type: str
    instance_type: str


_INSTANCES = msgspec.json.Decoder(dict[str, Instance])


def read_objects(
    instances_path: Path, boxes_path: Path, poses_path: Path
) -> tuple[tuple[adt.AdtObject, ...], tuple[str, ...]]:
    """All objects that have a name, a box and a pose, by id; people are no objects.

    Returns:
        The objects, and remarks on those that lack one of the three.

    Raises:
        InputFileError: for a missing or damaged file, a pose that is no pose, or a clock that runs backwards.
    """
    instances = read_instances(instances_path)
    boxes = _read_boxes(boxes_path)
    known = {key for key, instance in instances.items() if instance.instance_type != "human"}
    poses = read_poses_by_body(
        poses_path,
        body={adt.OBJECT_ID: int},
        time=adt.OBJECT_TIME,
        position=adt.OBJECT_POSITION,
        rotation=adt.OBJECT_ROTATION,
        static_time=adt.STATIC_TIME,
    )
    complete = sorted(known & boxes.keys() & poses.keys())
    objects = tuple(
        adt.AdtObject(
            object_id=key,
            name=instances[key].instance_name,
            prototype=instances[key].prototype_name,
            category=instances[key].category,
            dynamic=instances[key].motion_type == "dynamic",
            box_min=boxes[key][0],
            box_max=boxes[key][1],
            time_ns=poses[key][0],
            position=poses[key][1],
            rotation=poses[key][2],
        )
        for key in complete
    )
    incomplete = sorted((known | boxes.keys() | poses.keys()) - set(complete) - (instances.keys() - known))
    if not incomplete:
        return objects, ()
    named = ", ".join(str(key) for key in incomplete[:5]) + (" …" if len(incomplete) > 5 else "")
    return objects, (f"{len(incomplete)} objects without name, box or pose are left out: {named}",)


def read_instances(path: Path) -> dict[int, Instance]:
    """Objects and people by id; ids have up to 16 digits and stay integers.

    Raises:
        InputFileError: if the file is missing, damaged or lacks a key.
    """
    return {instance.instance_id: instance for instance in decode_json(path, _INSTANCES).values()}


def _read_boxes(path: Path) -> dict[int, tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
    """Lower and upper corner of each object's box in its own frame, metres.

    Raises:
        InputFileError: if the file or a column is missing, or a corner is no number.
    """
    table = read_columns(path, {adt.OBJECT_ID: int, **dict.fromkeys((*adt.BOX_MIN, *adt.BOX_MAX), float)})
    lower = column_vectors(table, adt.BOX_MIN)
    upper = column_vectors(table, adt.BOX_MAX)
    bad = ~(np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        found = f"{lower[row].tolist()} … {upper[row].tolist()}"
        raise InputFileError(path, f"line {row + 2}", expected="a lower and an upper corner", found=found)
    return dict(zip(table[adt.OBJECT_ID].to_pylist(), zip(lower, upper, strict=True), strict=True))
