"""Where the gaze meets the scan, the HoloLens files, and the transforms between suit, scan and room.

Sources: docs/specification/gimo.md#gaze and docs/specification/gimo.md#coordinate-chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.bounded import open_regular, read_text, read_whole, require_size
from prbench.geometry.skeleton import invert_rigid, transform_points
from prbench.geometry.timelines import covered, interpolate, slerp
from prbench.limits import HARMLESS_SIZE
from prbench.readers.files import decode_json, must_exist, require_increasing
from prbench.readers.gimo import format as gimo
from prbench.recording.streams import PoseStream

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
        body = content[header.size :]
        lines = body.splitlines()[: header.n_vertices]
        try:
            rows = np.array([[float(word) for word in line.split()[: len(names)]] for line in lines])
        except ValueError as error:
            raise InputFileError(path, "vertices", expected="numbers", found=str(error)) from error
        if rows.shape != (header.n_vertices, len(names)):
            raise _cut(path, header)
        return rows[:, [names.index(axis) for axis in "xyz"]]
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


_WIDTH = 861
_TICK = 0
_HEAD = 1
_GAZE_VALID = 851
_GAZE_ORIGIN = 852
_GAZE_DIRECTION = 856
_VIDEO_WIDTH = 18
_VIDEO_POSE = 2
_CPF_FROM_HOLOLENS = np.diag([-1.0, 1.0, -1.0])  # x right, y up, z back → x left, y up, z forward
_CAMERA_FROM_HOLOLENS = np.diag([1.0, -1.0, -1.0])  # → x right, y down, z forward
_TICKS_A_SECOND = 1e7
_LONGEST_STEP = 0.1  # seconds between two rows; the recorder runs at about 60 Hz
_IDENTITY = np.array([[1.0, 0.0, 0.0, 0.0]])


@dataclass(frozen=True)
class GlassesStreams:
    """Streams of the glasses in the room; empty where there are no files, or none that fit."""

    head: PoseStream
    camera: PoseStream
    eye: PoseStream | None = None
    """Between the eyes; None without HoloLens files."""
    messages: tuple[str, ...] = ()


def read_hololens(stream: Path, video: Path, transform: Path) -> gimo.HoloLens:
    """Head, eyes and camera in the world of the glasses.

    Args:
        stream: ``*_head_hand_eye.csv``.
        video: ``*_pv.txt``.
        transform: ``transform_scene2scene``.

    Raises:
        InputFileError: if a file is missing, or its rows have another width, no numbers, or a clock that stands still.
    """
    # Ticks, and the columns that are needed, each in its place; the hands stay unread (zeros).
    wanted = [*range(_HEAD, _HEAD + 16), *range(_GAZE_VALID, _WIDTH)]
    names = [str(column) for column in range(_WIDTH)]
    types = {names[column]: pa.float64() for column in wanted} | {names[_TICK]: pa.int64()}
    with must_exist(stream):
        require_size(stream)
    try:
        table = pyarrow.csv.read_csv(
            stream,
            read_options=pyarrow.csv.ReadOptions(column_names=names),
            convert_options=pyarrow.csv.ConvertOptions(include_columns=list(types), column_types=types),
        )
    except pa.ArrowInvalid as error:
        raise InputFileError(
            stream,
            "",
            expected=f"rows of {_WIDTH} numbers without header, the first a whole one",
            found=str(error).splitlines()[0],
            remedy="The file is cut, or of another recorder.",
        ) from error
    rows = np.zeros((len(table), _WIDTH))
    for column in wanted:
        rows[:, column] = table[names[column]].to_numpy()
    ticks, rows = table[names[_TICK]].to_numpy(), rows
    require_increasing(stream, ticks, unit="ticks", first=1)
    video_ticks, frames = _read_video(video)
    require_increasing(video, video_ticks, unit="ticks")
    return gimo.HoloLens(
        ticks=ticks,
        head=rows[:, _HEAD : _HEAD + 16].reshape(-1, 4, 4),
        gaze_valid=rows[:, _GAZE_VALID] != 0,
        gaze_origin=rows[:, _GAZE_ORIGIN : _GAZE_ORIGIN + 3],
        gaze_direction=rows[:, _GAZE_DIRECTION : _GAZE_DIRECTION + 3],
        video_ticks=video_ticks,
        camera=frames[:, _VIDEO_POSE : _VIDEO_POSE + 16].reshape(-1, 4, 4),
        transform=read_matrix(transform),
    )


def _read_video(path: Path) -> tuple[Int[np.ndarray, " f"], Float[np.ndarray, "f 18"]]:
    """Lines after the first (which holds the principal point and the size): ticks, then focal lengths and pose."""
    try:
        with must_exist(path):
            lines = [line.split(",") for line in read_text(path).splitlines()[1:] if line.strip()]
        ticks = np.array([int(line[0]) for line in lines], dtype=np.int64)
        rows = np.array([[float(word) for word in line[1:]] for line in lines])
    except ValueError as error:
        raise InputFileError(path, "", expected="rows of equally many numbers", found=str(error)) from error
    if rows.ndim != 2 or rows.shape[1] != _VIDEO_WIDTH:
        width = rows.shape[1] + 1 if rows.ndim == 2 else 0
        raise InputFileError(path, "", expected=f"rows of {_VIDEO_WIDTH + 1} numbers", found=f"{width}")
    return ticks, rows


def glasses_streams(
    readings: gimo.GimoReadings, head_joint: PoseStream, *, limit: float, required: bool
) -> GlassesStreams:
    """The glasses on the frames of the segment.

    Args:
        readings: With or without HoloLens files.
        head_joint: Where the body's head is, on the frames of the segment; decides the direction of the transform.
        limit: Median distance of glasses and head joint that is still believed, metres.
        required: Whether the user asked for these files.

    Raises:
        InputFileError: if they are required and missing, or lie further from the head in either direction.
    """
    where = f"{readings.segment.scene}/{readings.segment.sequence}"
    if readings.hololens is None:
        if required:
            raise InputFileError(
                where,
                "",
                expected=f"*{gimo.HOLOLENS_SUFFIX}, *{gimo.VIDEO_SUFFIX} and {gimo.HOLOLENS_TRANSFORM_FILES[0]}",
                found="not all of them",
                remedy="Use the option gaze_origin=head, or download these files.",
            )
        return GlassesStreams(_no_poses(), _no_poses())
    hololens = readings.hololens
    frames = np.rint(head_joint.times * gimo.FRAME_RATE).astype(np.int64)
    on_video = frames < len(hololens.video_ticks)
    frames = np.minimum(frames, len(hololens.video_ticks) - 1)
    # Counted from the first tick: a float does not hold ticks since an epoch exactly.
    first = int(hololens.ticks[0])
    rows = (hololens.ticks - first) / _TICKS_A_SECOND
    query = (hololens.video_ticks[frames] - first) / _TICKS_A_SECOND
    tracked = on_video & covered(rows, np.ones(len(rows), dtype=bool), query, max_gap=_LONGEST_STEP)
    position = interpolate(rows, hololens.head[:, :3, 3], query)

    # The file does not say in which direction its transform leads: the one that brings the glasses nearer to the head.
    both = tracked & head_joint.valid
    scan_from_glasses = (hololens.transform, invert_rigid(hololens.transform))
    candidates = [readings.transform.room_from_scan() @ scan_from for scan_from in scan_from_glasses]
    distances = [
        float(np.median(np.linalg.norm(transform_points(room, position[both]) - head_joint.position[both], axis=1)))
        for room in candidates
        if both.any()
    ]
    if not distances or min(distances) > limit:
        found = " and ".join(f"{distance:.2f} m" for distance in distances) or "no frame with both"
        if required:
            raise InputFileError(
                f"{where}/{gimo.HOLOLENS_TRANSFORM_FILES[0]}",
                "",
                expected=f"a transform that brings the glasses within {limit} m of the head joint",
                found=f"{found} (as it stands, and inverted)",
                remedy="Use the option gaze_origin=head.",
            )
        message = f"HoloLens files not used: glasses {found} from the head joint (transform as it stands, inverted)"
        return GlassesStreams(_no_poses(), _no_poses(), None, (message,))
    room_from_glasses = candidates[int(np.argmin(distances))]
    # The cube root of the determinant is the scale by which the transform shrinks; the shrinking turns nothing.
    room_rotation = Rotation.from_matrix(room_from_glasses[:3, :3] / np.cbrt(np.linalg.det(room_from_glasses[:3, :3])))

    def in_room(position: np.ndarray, rotation: Rotation, part_from_own: np.ndarray, valid: np.ndarray) -> PoseStream:
        turned = room_rotation * rotation * Rotation.from_matrix(part_from_own)
        quaternions = turned.as_quat(canonical=True, scalar_first=True)
        return PoseStream(head_joint.times, transform_points(room_from_glasses, position), quaternions, valid)

    head_rows = Rotation.from_matrix(hololens.head[:, :3, :3]).as_quat(scalar_first=True)
    head = Rotation.from_quat(slerp(rows, head_rows, query), scalar_first=True)
    camera = hololens.camera[frames]
    gazed = hololens.gaze_valid
    eye = hololens.gaze_origin[gazed] if gazed.any() else hololens.gaze_origin
    eye_rows = rows[gazed] if gazed.any() else rows
    return GlassesStreams(
        head=in_room(position, head, _CPF_FROM_HOLOLENS, tracked),
        camera=in_room(camera[:, :3, 3], Rotation.from_matrix(camera[:, :3, :3]), _CAMERA_FROM_HOLOLENS, on_video),
        eye=PoseStream(
            head_joint.times,
            transform_points(room_from_glasses, interpolate(eye_rows, eye, query)),
            np.repeat(_IDENTITY, len(head_joint.times), axis=0),
            on_video & covered(rows, gazed, query, max_gap=_LONGEST_STEP),
        ),
    )


def _no_poses() -> PoseStream:
    return PoseStream(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0, dtype=bool))


_ROTATION_TOLERANCE = 1e-3


class _TransformInfo(msgspec.Struct):
    scale: float
    transformation: list[list[float]]


_INFO = msgspec.json.Decoder(_TransformInfo)
_MATRIX = msgspec.json.Decoder(dict[str, list[list[float]]])


def read_transform(info: Path, norm: Path) -> gimo.SceneTransform:
    """Scale and both matrices of a segment.

    Raises:
        InputFileError: if a file is missing or no 4x4 rigid transform, or there is no positive scale.
    """
    content = decode_json(info, _INFO)
    if not np.isfinite(content.scale) or content.scale <= 0:
        raise InputFileError(info, "scale", expected="a positive number", found=f"{content.scale}")
    return gimo.SceneTransform(
        content.scale,
        _rigid(info, "transformation", np.array(content.transformation, dtype=object)),
        read_matrix(norm),
    )


def read_matrix(path: Path) -> Float[np.ndarray, "4 4"]:
    """A rigid transform from a text file of sixteen numbers, or a JSON file whose first entry is a 4x4 list.

    Raises:
        InputFileError: if the file is missing, or holds anything else.
    """
    if path.suffix == ".json":
        rows = next(iter(decode_json(path, _MATRIX).values()), [])
        return _rigid(path, "", np.array(rows, dtype=object))
    try:
        with must_exist(path):
            words = read_text(path, largest=HARMLESS_SIZE).replace(",", " ").split()
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputFileError(path, "", expected="a 4x4 matrix of numbers", found=str(error)) from error
    return _rigid(path, "", numbers)


def _rigid(path: Path, where: str, values: np.ndarray) -> Float[np.ndarray, "4 4"]:
    try:
        numbers = values.astype(np.float64)
    except (ValueError, TypeError) as error:
        raise InputFileError(path, where, expected="a 4x4 matrix of numbers", found="rows of unequal length") from error
    if numbers.size != 16:
        raise InputFileError(
            path, where, expected="a 4x4 matrix", found=f"{numbers.size} numbers", remedy="Copy the file again."
        )
    matrix = numbers.reshape(4, 4)
    rotation = matrix[:3, :3]
    if not np.isfinite(matrix).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROTATION_TOLERANCE:
        raise InputFileError(
            path,
            where,
            expected="a rotation with a translation (the scale stands apart)",
            found="a matrix that stretches, or NaN",
        )
    if np.linalg.det(rotation) < 0:
        raise InputFileError(path, where, expected="a rotation with a translation", found="a reflection")
    return matrix
