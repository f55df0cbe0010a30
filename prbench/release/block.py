"""Arrays of a release, read without trust, and the ``prbench`` block: what the authors' layout has no place for.

Motions and gazes are ``.npy`` files that nobody vouches for: the header is checked against the file's size, objects are
refused, nothing is unpickled. The block of an entry and the arrays of ``further/`` are ours; other tools pass over
both. Together with the layout's own fields they hold every column of the sequence table, so that a table comes back
unchanged.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from prbench.errors import InputFileError
from prbench.files.bounded import open_regular
from prbench.files.numpy_files import Archive, ArrayHeader, read_header

_REQUIRED = ("previous_joints", "next_joints", "gaze_origin", "gaze_direction", "gaze_valid")
_HEAD = ("head_position", "head_rotation")  # both or none
_ACCEPTED = (np.dtype(np.float32), np.dtype(np.float64))
_REMEDY = "Copy or download the file again."
_HEADER_BYTES = 12_000  # numpy's own limit is 10,000


class Block(msgspec.Struct, frozen=True, kw_only=True):
    """Columns of one sequence that the layout lacks; world box in the world, everything else as in the table."""

    sequence_id: str
    event_id: str
    recording_id: str
    participant_id: str
    split_group: str
    action: str
    object_id: str
    object_name: str
    text: str
    hand: str | None
    n_frames: int
    start_time: float
    prime_time: float
    event_time: float
    prime_gap: float
    preroll: float
    prime_kind: str
    prime_time_uncertainty: float | None
    goal_box_world_min: tuple[float, float, float]
    goal_box_world_max: tuple[float, float, float]
    body_movement: float
    hand_movement: float
    pose_source: str
    head_tilt_deg: float
    previous_source: str
    next_source: str
    world_from_canonical: tuple[float, ...]
    motion_frame: str
    """Frame of motions, goal and gazes of this file: ``canonical`` or ``world``."""
    goal_frame: str = "known"
    """``unknown`` where the table itself came from a release whose goals could not be placed."""
    extra: dict[str, str]

    def __post_init__(self) -> None:
        # The block is a user's file like any other: JSON of our exporter may have been edited.
        numbers = (self.start_time, self.prime_time, self.event_time, *self.world_from_canonical)
        if len(self.world_from_canonical) != 16 or not all(map(math.isfinite, numbers)):
            raise ValueError("world_from_canonical must hold 16 finite numbers, and times be finite")


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Pack arrays as an uncompressed ``.npz``, with equal bytes for equal values."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, values in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(values), allow_pickle=False)
            # A fresh ZipInfo holds a fixed date, so that equal arrays give equal bytes.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue())
    return stream.getvalue()


def unpack_arrays(path: Path, content: bytes) -> dict[str, np.ndarray]:
    """Read the known arrays of a ``.npz`` without trusting it.

    Raises:
        InputFileError: if it is damaged, compressed, or holds objects.
    """
    archive = Archive(path, content)
    # Our exporter never compresses; a compressed member may unpack to any size.
    if not all(map(archive.stored_as_is, archive.members)):
        raise InputFileError(path, "", expected="arrays without compression", found="compressed ones")
    return archive.load((*_REQUIRED, *_HEAD))


def fits(arrays: Mapping[str, np.ndarray], n_frames: int) -> bool:
    """Return True if the arrays are complete and belong to a motion of this length."""
    shapes = {
        "previous_joints": (22, 3),
        "next_joints": (22, 3),
        "gaze_origin": (n_frames, 3),
        "gaze_direction": (n_frames, 3),
        "gaze_valid": (n_frames,),
        "head_position": (n_frames, 3),
        "head_rotation": (n_frames, 4),
    }
    return (
        set(_REQUIRED) <= set(arrays)
        # Position and rotation of the head come together or not at all.
        and len(set(_HEAD) & set(arrays)) != 1
        and all(values.shape == shapes[name] and values.dtype.kind in "fb" for name, values in arrays.items())
        and all(np.isfinite(values).all() for values in arrays.values())
    )


def scan_header(path: Path) -> ArrayHeader:
    """Read the header of a file without its values.

    Raises:
        InputFileError: see :func:`_parse_header`, or if the file cannot be opened.
    """
    try:
        with open_regular(path) as file:
            return _parse_header(path, file.read(_HEADER_BYTES), path.stat().st_size)
    except OSError as error:
        raise _no_array(path, "a readable file", str(error.strerror or error)) from error


def parse_array(path: Path, content: bytes) -> np.ndarray:
    """Return the array of a ``.npy`` file whose bytes were read.

    Raises:
        InputFileError: see :func:`_parse_header`.
    """
    header = _parse_header(path, content, len(content))
    return header.shaped(np.frombuffer(content, header.dtype, math.prod(header.shape), header.offset))


def _parse_header(path: Path, content: bytes, size: int) -> ArrayHeader:
    """Read the header and check that the file is as long as it claims.

    Args:
        path: File, for messages.
        content: The beginning of the file.
        size: Size of the whole file, bytes.

    Raises:
        InputFileError: if this is no ``.npy`` file, holds objects, or is truncated.
    """
    header = read_header(io.BytesIO(content), path, "", remedy=_REMEDY)
    expected = header.offset + header.nbytes
    if size != expected:
        raise _no_array(path, f"{expected} bytes for shape {header.shape}", f"{size}")
    return header


def require_frames(path: Path, header: ArrayHeader, per_frame: tuple[int, ...]) -> int:
    """Return the number of frames of an array of shape (N, *per_frame) in single or double precision.

    Raises:
        InputFileError: for another shape or kind of number.
    """
    # Either byte order is accepted, so the comparison must not see it.
    native = header.dtype.newbyteorder("=")
    if native not in _ACCEPTED:
        raise _no_array(path, "float32 or float64", str(header.dtype))
    if len(header.shape) != 1 + len(per_frame) or header.shape[1:] != per_frame:
        wanted = ", ".join(("N", *map(str, per_frame)))
        raise _no_array(path, f"shape ({wanted})", str(header.shape))
    return header.shape[0]


def _no_array(path: Path, expected: str, found: str) -> InputFileError:
    return InputFileError(path, "", expected=expected, found=found, remedy=_REMEDY)
