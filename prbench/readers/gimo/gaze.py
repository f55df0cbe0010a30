"""``eye_pc``: where the gaze meets the scan (docs/specification/gimo.md#gaze)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import open_regular, read_whole
from prbench.readers.files import must_exist
from prbench.readers.gimo import format as gimo

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 16
_MOST_DIGITS = 12  # of a number of vertices


@dataclass(frozen=True)
class _PlyHeader:
    """The part of a PLY header that vertices need."""

    form: str
    """``ascii``, ``binary_little_endian`` or ``binary_big_endian``."""
    n_vertices: int
    properties: tuple[tuple[str, str], ...]
    """Name and type code of each vertex property."""
    size: int
    """Bytes up to the first vertex."""


def read_gaze(cones: Mapping[int, Path], centres: Mapping[int, Path]) -> tuple[gimo.GazePoints, tuple[str, ...]]:
    """The gaze point of every frame that has one: the first vertex of ``<frame>_center.ply``.

    A frame has none when one of its two files is missing, damaged or without vertices, or when the point is the origin.

    Args:
        cones: ``<frame>.ply`` by frame: scene points inside the cone of the gaze; only counted.
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
            seen = len(vertices) > 0 and count_vertices(cones[frame]) > 0
        except InputFileError as error:
            damaged.append(error)
            continue
        if seen and np.isfinite(vertices[0]).all() and np.abs(vertices[0]).sum() >= gimo.NO_POINT:
            frames.append(frame)
            points.append(vertices[0])
    found = gimo.GazePoints(np.array(frames, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3))
    return found, _remarks(damaged)


def read_vertices(path: Path) -> Float[np.ndarray, "v 3"]:
    """Positions of all vertices, in the unit of the file.

    Raises:
        InputFileError: if the file is missing, no PLY, shorter than its header says, or its vertices have no x, y, z.
    """
    with must_exist(path):
        content = read_whole(path)
    header = parse_header(path, content)
    names = [name for name, _ in header.properties]
    if header.n_vertices == 0:
        return np.zeros((0, 3))
    if not {"x", "y", "z"} <= set(names):
        raise InputFileError(path, "header", expected="vertex properties x, y, z", found=", ".join(names) or "none")
    if header.form == "ascii":
        return _ascii_vertices(path, content[header.size :], header, names)
    order = _ORDERS[header.form]
    kind = np.dtype([(name, order + code) for name, code in header.properties])
    if len(content) - header.size < header.n_vertices * kind.itemsize:
        raise _cut(path, header)
    rows = np.frombuffer(content, kind, header.n_vertices, header.size)
    return np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])


def parse_header(path: Path, content: bytes) -> _PlyHeader:
    """The header of a PLY file whose first element is ``vertex``.

    Raises:
        InputFileError: if there is none.
    """
    end = content.find(b"end_header", 0, _LONGEST_HEADER)
    stop = content.find(b"\n", end) + 1
    if not content.startswith(b"ply") or end < 0 or stop <= 0:
        raise InputFileError(
            path,
            "",
            expected="a PLY file",
            found="a file without its header" if content else "an empty file",
            remedy="Copy the file again.",
        )
    form = ""
    element = ""
    n_vertices = 0
    properties: list[tuple[str, str]] = []
    for line in content[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3:
            element = words[1]
            n_vertices = _count(path, words[2]) if element == "vertex" else n_vertices
        elif words[:1] == ["property"] and element == "vertex" and len(words) == 3 and words[1] in _TYPES:
            properties.append((words[2], _TYPES[words[1]]))
    if form != "ascii" and form not in _ORDERS:
        raise InputFileError(path, "header", expected="a known PLY format", found=f"'{form}'")
    names = [name for name, _ in properties]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise InputFileError(path, "header", expected="each vertex property once", found=f"'{repeated}' again")
    return _PlyHeader(form, n_vertices, tuple(properties), stop)


def _count(path: Path, word: str) -> int:
    if not word.isdecimal() or len(word) > _MOST_DIGITS:
        raise InputFileError(path, "header", expected="a number of vertices", found=f"'{word}'")
    return int(word)


def _ascii_vertices(path: Path, body: bytes, header: _PlyHeader, names: list[str]) -> Float[np.ndarray, "v 3"]:
    lines = body.splitlines()[: header.n_vertices]
    try:
        rows = np.array([[float(word) for word in line.split()[: len(names)]] for line in lines])
    except ValueError as error:
        raise InputFileError(path, "vertices", expected="numbers", found=str(error)) from error
    if rows.shape != (header.n_vertices, len(names)):
        raise _cut(path, header)
    return rows[:, [names.index(axis) for axis in "xyz"]]


def _cut(path: Path, header: _PlyHeader) -> InputFileError:
    return InputFileError(
        path,
        "",
        expected=f"{header.n_vertices} vertices",
        found="fewer bytes than that",
        remedy="The file is cut; copy it again.",
    )


def count_vertices(path: Path) -> int:
    """Return the number of vertices that the header promises; the rest is not read.

    Raises:
        InputFileError: see :func:`read_vertices`.
    """
    with open_regular(path) as file:
        return parse_header(path, file.read(_LONGEST_HEADER)).n_vertices


def _remarks(damaged: list[InputFileError]) -> tuple[str, ...]:
    if not damaged:
        return ()
    first = damaged[0]
    return (
        f"{len(damaged)} damaged gaze files are left out, first: {first.path.name}: expected {first.expected}, found"
        f" {first.found}",
    )
