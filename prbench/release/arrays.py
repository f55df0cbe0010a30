"""Arrays of a release, read without trust: headers are held against the file's size, and nothing is unpickled."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.files.arrays import Archive, read_header
from prbench.files.bounded import foreign_input, read_whole
from prbench.limits import HARMLESS_SIZE

FURTHER_ARRAYS = {
    "previous_joints": (22, 3),
    "next_joints": (22, 3),
    "gaze_origin": (-1, 3),
    "gaze_direction": (-1, 3),
    "gaze_valid": (-1,),
    "head_position": (-1, 3),
    "head_rotation": (-1, 4),
}
"""Columns for whose arrays the authors' layout has no place, and their shapes; -1 is the number of frames."""
_HEAD = ("head_position", "head_rotation")  # both or none
_REMEDY = "Copy or download the file again."


@foreign_input()
def read_array(path: Path, per_frame: tuple[int, ...]) -> tuple[np.ndarray, bytes]:
    """Read the array (N, *per_frame) of a ``.npy`` file in single or double precision.

    Returns:
        The array as it stands in the file, and the bytes of the file.

    Raises:
        InputFileError: if this is no ``.npy`` file, holds objects, is truncated, or has another shape or other
            numbers.
    """
    content = read_whole(path, largest=HARMLESS_SIZE)
    header = read_header(io.BytesIO(content), path, "", remedy=_REMEDY)
    wanted = ", ".join(("N", *map(str, per_frame)))
    for expected, found, right in (
        (f"{header.offset + header.nbytes} bytes for shape {header.shape}", str(len(content)),
         len(content) == header.offset + header.nbytes),
        # Either byte order is accepted, so the comparison must not see it.
        ("float32 or float64", str(header.dtype), header.dtype.newbyteorder("=") in (np.float32, np.float64)),
        (f"shape ({wanted})", str(header.shape), len(header.shape) > 0 and header.shape[1:] == per_frame),
    ):  # fmt: skip
        if not right:
            raise InputFileError(path, "", expected=expected, found=found, remedy=_REMEDY)
    return header.shaped(np.frombuffer(content, header.dtype, math.prod(header.shape), header.offset)), content


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


@foreign_input()
def read_further(path: Path, n_frames: int) -> tuple[dict[str, np.ndarray], bytes]:
    """Read the arrays of a ``.npz`` that :func:`pack_arrays` made, without trusting it.

    Returns:
        The arrays by name, and the bytes of the file.

    Raises:
        InputFileError: if it is damaged, compressed, holds objects, or belongs to a motion of another length.
    """
    content = read_whole(path, largest=HARMLESS_SIZE)
    archive = Archive(path, content)
    # Our exporter never compresses; a compressed member may unpack to any size.
    if not all(map(archive.stored_as_is, archive.members)):
        raise InputFileError(path, "", expected="arrays without compression", found="compressed ones")
    arrays = archive.load(tuple(FURTHER_ARRAYS))
    shapes = {name: tuple(n_frames if size < 0 else size for size in shape) for name, shape in FURTHER_ARRAYS.items()}
    whole = set(FURTHER_ARRAYS) - set(arrays) in (set(), set(_HEAD))
    fits = all(
        values.shape == shapes[name] and values.dtype.kind in "fb" and np.isfinite(values).all()
        for name, values in arrays.items()
    )
    if not (whole and fits):
        raise InputFileError(
            path, "", expected="the arrays of this sequence", found="others", remedy="Export it again."
        )
    return arrays, content
