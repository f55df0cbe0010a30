"""Points at which the gaze meets the scan, and the transforms between suit, scan and room.

Sources: docs/specification/gimo.md#gaze and docs/specification/gimo.md#coordinate-chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import read_text, read_whole, require
from prbench.limits import HARMLESS_SIZE
from prbench.readers.files import decode_json, must_exist
from prbench.readers.gimo import format as gimo

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 16
_MOST_DIGITS = 12  # of a number of vertices
_ROTATION_TOLERANCE = 1e-3


def read_gaze(cones: Mapping[int, Path], centres: Mapping[int, Path]) -> tuple[gimo.GazePoints, tuple[str, ...]]:
    """Read the gaze point of every frame that has one: the first vertex of ``<frame>_center.ply``.

    A frame has none when one of its two files is missing, damaged or without vertices, or when the point is the origin.

    Args:
        cones: ``<frame>.ply`` by frame: scene points inside the cone of the gaze.
        centres: ``<frame>_center.ply`` by frame.

    Returns:
        The points, and remarks about damaged files.
    """
    frames = []
    points = []
    damaged: list[InputFileError] = []
    for frame in sorted(cones.keys() & centres.keys()):
        try:
            vertices = read_vertices(centres[frame])
            seen = len(vertices) > 0 and len(read_vertices(cones[frame])) > 0
        except InputFileError as error:
            damaged.append(error)
            continue
        if seen and np.isfinite(vertices[0]).all() and np.abs(vertices[0]).sum() >= gimo.NO_POINT:
            frames.append(frame)
            points.append(vertices[0])
    found = gimo.GazePoints(np.array(frames, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3))
    if not damaged:
        return found, ()
    first = damaged[0]
    said = f"first: {first.path.name}: expected {first.expected}, found {first.found}"
    return found, (f"{len(damaged)} damaged gaze files are left out, {said}",)


def read_vertices(path: Path) -> Float[np.ndarray, "v 3"]:
    """Read the positions of all vertices of a PLY file whose first element is ``vertex``, in the unit of the file.

    Raises:
        InputFileError: if the file is missing, no binary PLY, shorter than its header says, or its vertices have no
            x, y, z.
    """
    with must_exist(path):
        content = read_whole(path)
    end = content.find(b"end_header", 0, _LONGEST_HEADER)
    start = content.find(b"\n", end) + 1
    is_ply = content.startswith(b"ply") and end >= 0 and start > 0
    found = "a file without its header" if content else "an empty file"
    require(path, (is_ply, "", "a PLY file", found, "Copy the file again."))
    form = ""
    element = ""
    count = "0"
    properties: list[tuple[str, str]] = []
    for line in content[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3:
            element = words[1]
            count = words[2] if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex" and len(words) == 3 and words[1] in _TYPES:
            properties.append((words[2], _TYPES[words[1]]))
    names = [name for name, _ in properties]
    listed = ", ".join(names) or "none"
    require(
        path,
        (form in _ORDERS, "header", "a binary PLY format", f"'{form}'", ""),
        (count.isdecimal() and len(count) <= _MOST_DIGITS, "header", "a number of vertices", f"'{count}'", ""),
        (len(set(names)) == len(names), "header", "each vertex property once", listed, ""),
    )
    if int(count) == 0:
        return np.zeros((0, 3))
    kind = np.dtype([(name, _ORDERS[form] + code) for name, code in properties])
    is_whole = len(content) - start >= int(count) * kind.itemsize
    require(
        path,
        ({"x", "y", "z"} <= set(names), "header", "vertex properties x, y, z", listed, ""),
        (is_whole, "", f"{count} vertices", "fewer bytes than that", "The file is cut; copy it again."),
    )
    rows = np.frombuffer(content, kind, int(count), start)
    return np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])


def read_transform(info: Path, norm: Path) -> gimo.SceneTransform:
    """Read the scale and both matrices of a segment.

    Args:
        info: ``transform_info*.json``.
        norm: ``transform_norm.txt``, sixteen numbers.

    Raises:
        InputFileError: if a file is missing or no 4x4 rigid transform, or there is no positive scale.
    """
    content = decode_json(info, _TransformInfo)
    require(info, (0 < content.scale < np.inf, "scale", "a positive number", content.scale, ""))
    try:
        with must_exist(norm):
            words = read_text(norm, largest=HARMLESS_SIZE).replace(",", " ").split()
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputFileError(norm, "", expected="a 4x4 matrix of numbers", found=str(error)) from error
    flat = np.array([number for row in content.transformation for number in row], dtype=np.float64)
    return gimo.SceneTransform(content.scale, _rigid(info, "transformation", flat), _rigid(norm, "", numbers))


def _rigid(path: Path, where: str, numbers: Float[np.ndarray, " n"]) -> Float[np.ndarray, "4 4"]:
    require(path, (numbers.size == 16, where, "a 4x4 matrix", f"{numbers.size} numbers", "Copy the file again."))
    matrix = numbers.reshape(4, 4)
    rotation = matrix[:3, :3]
    keeps_lengths = np.isfinite(matrix).all() and np.abs(rotation @ rotation.T - np.eye(3)).max() <= _ROTATION_TOLERANCE
    expected = "a rotation with a translation (the scale stands apart)"
    require(path, (keeps_lengths, where, expected, "a matrix that stretches, or NaN", ""))
    require(path, (np.linalg.det(rotation) > 0, where, "a rotation with a translation", "a reflection", ""))
    return matrix


class _TransformInfo(msgspec.Struct):
    scale: float
    transformation: list[list[float]]
