"""Read ``.npy`` files that nobody vouches for: header checked against the file's size, objects refused, no pickle."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np

from prbench.bounded import open_regular
from prbench.errors import InputFileError
from prbench.numpy_files import ArrayHeader, read_header

_ACCEPTED = (np.dtype(np.float32), np.dtype(np.float64))
_REMEDY = "Copy or download the file again."
_HEADER_BYTES = 12_000  # numpy's own limit is 10,000


def parse_header(path: Path, content: bytes, size: int) -> ArrayHeader:
    """Read the header and check that the file is as long as it claims.

    Args:
        path: For messages.
        content: The beginning of the file.
        size: Of the whole file, bytes.

    Raises:
        InputFileError: if this is no ``.npy`` file, holds objects, or is truncated.
    """
    header = read_header(io.BytesIO(content), path, "", remedy=_REMEDY)
    expected = header.offset + header.nbytes
    if size != expected:
        raise _no_array(path, f"{expected} bytes for shape {header.shape}", f"{size}")
    return header


def scan_header(path: Path) -> ArrayHeader:
    """The header of a file, without its values.

    Raises:
        InputFileError: see :func:`parse_header`, or if the file cannot be opened.
    """
    try:
        with open_regular(path) as file:
            return parse_header(path, file.read(_HEADER_BYTES), path.stat().st_size)
    except OSError as error:
        raise _no_array(path, "a readable file", str(error.strerror or error)) from error


def parse_array(path: Path, content: bytes) -> np.ndarray:
    """The values of a ``.npy`` file whose bytes were read.

    Raises:
        InputFileError: see :func:`parse_header`.
    """
    header = parse_header(path, content, len(content))
    return header.shaped(np.frombuffer(content, header.dtype, math.prod(header.shape), header.offset))


def require_frames(path: Path, header: ArrayHeader, per_frame: tuple[int, ...]) -> int:
    """The number of frames of an array of shape (N, *per_frame) in single or double precision.

    Raises:
        InputFileError: for another shape or kind of number.
    """
    native = header.dtype.newbyteorder("=")
    if native not in _ACCEPTED:
        raise _no_array(path, "float32 or float64", str(header.dtype))
    if len(header.shape) != 1 + len(per_frame) or header.shape[1:] != per_frame:
        wanted = ", ".join(("N", *map(str, per_frame)))
        raise _no_array(path, f"shape ({wanted})", str(header.shape))
    return header.shape[0]


def _no_array(path: Path, expected: str, found: str) -> InputFileError:
    return InputFileError(path, "", expected=expected, found=found, remedy=_REMEDY)
