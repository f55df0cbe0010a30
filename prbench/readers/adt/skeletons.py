"""Tracked people of an ADT recording (docs/specification/adt.md#files and docs/specification/adt.md#joints).

A skeleton file has about 26 MB a minute. Only joints and times are taken out of it, and the joints go as text to
Arrow's CSV parser: half the time, and a fraction of the memory, of decoding lists of lists and making an array of them.
"""

from __future__ import annotations

import io
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.readers.adt import format as adt
from prbench.readers.adt.layouts import ASSOCIATION, SKELETON_PREFIX
from prbench.readers.files import decode_json, require_increasing
from prbench.readers.found import RecordingFiles


class _Association(msgspec.Struct):
    """One tracked person and the glasses that the person wears; ``NONE`` stands for nobody."""

    serial: str = msgspec.field(name="AssociatedDeviceSerial")
    skeleton_id: int | str = msgspec.field(name="SkeletonId")
    name: str = msgspec.field(name="SkeletonName")


class _Associations(msgspec.Struct):
    """The association file."""

    people: tuple[_Association, ...] = msgspec.field(name="SkeletonMetadata")


class _Frame(msgspec.Struct):
    joints: msgspec.Raw
    timestamp_ns: int


class _SkeletonFile(msgspec.Struct):
    frames: list[_Frame]


_ASSOCIATIONS = msgspec.json.Decoder(_Associations)
_SKELETON = msgspec.json.Decoder(_SkeletonFile)


def read_skeletons(found: RecordingFiles) -> tuple[adt.AdtSkeleton, ...]:
    """Every tracked person of a recording.

    Raises:
        InputFileError: if a skeleton's file is missing or damaged, or is not the skeleton of 51 joints.
    """
    return tuple(_read_skeleton(found, person) for person in _read_associations(found))


def _read_skeleton(found: RecordingFiles, person: _Association) -> adt.AdtSkeleton:
    path = found.require(f"{SKELETON_PREFIX}{person.name}", f"{person.name}.json")
    frames = decode_json(path, _SKELETON, nan_is_null=True).frames
    if not frames:
        raise InputFileError(
            path,
            "frames",
            expected="frames of a body",
            found="none",
            remedy=f"Download the recording again, or remove {person.name} from the association file.",
        )
    times = np.array([frame.timestamp_ns for frame in frames], dtype=np.int64)
    require_increasing(path, times, unit="ns", place="frame", first=0)
    skeleton_id = person.skeleton_id if isinstance(person.skeleton_id, int) else -1
    return adt.AdtSkeleton(person.name, skeleton_id, person.serial, times, _parse_joints(path, frames))


def _parse_joints(path: Path, frames: list[_Frame]) -> Float[np.ndarray, "n 51 3"]:
    rows = [bytes(frame.joints).translate(None, b"[] \t\r\n") for frame in frames]
    width = 3 * adt.N_NATIVE_JOINTS
    other = next((index for index, row in enumerate(rows) if row.count(b",") != width - 1), None)
    if other is not None:
        raise InputFileError(
            path,
            f"frame {other}, joints",
            expected=f"the known skeleton of {adt.N_NATIVE_JOINTS} joints with three coordinates",
            found=f"{rows[other].count(b',') + bool(rows[other])} numbers instead of {width}",
            remedy="The order of the joints is a constant of the format; another skeleton cannot be mapped.",
        )
    names = [str(column) for column in range(width)]
    try:
        table = pyarrow.csv.read_csv(
            io.BytesIO(b"\n".join(rows)),
            read_options=pyarrow.csv.ReadOptions(column_names=names, block_size=1 << 22),
            convert_options=pyarrow.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64())),
        )
    except pa.ArrowInvalid as error:
        raise InputFileError(
            path, "joints", expected="numbers", found=str(error).splitlines()[0], remedy="Download the file again."
        ) from error
    return np.column_stack([table[name].to_numpy() for name in names]).reshape(-1, adt.N_NATIVE_JOINTS, 3)


def _read_associations(found: RecordingFiles) -> tuple[_Association, ...]:
    """The tracked people of a recording; none where it has no association file.

    Raises:
        InputFileError: if the file is damaged.
    """
    path = found.path(ASSOCIATION)
    return () if path is None else tuple(p for p in decode_json(path, _ASSOCIATIONS).people if p.name != adt.NOBODY)
