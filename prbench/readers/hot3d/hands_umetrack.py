"""UmeTrack hands: poses line by line, and the user's hand model (docs/specification/hot3d.md#files)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from prbench.bounded import open_regular, whole_lines
from prbench.errors import InputFileError
from prbench.readers.files import Nanoseconds, decode_json, missing_file, require_increasing
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import umetrack

_QUATERNION_TOLERANCE = 1e-3
_FARTHEST = 1.0  # metres from the wrist, many times as long as a hand


class _Wrist(msgspec.Struct):
    t_xyz: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]


class _UmeTrackHand(msgspec.Struct):
    wrist_xform: _Wrist
    joint_angles: tuple[float, ...]


class _UmeTrackLine(msgspec.Struct):
    timestamp_ns: Nanoseconds
    hand_poses: dict[str, _UmeTrackHand]


_DECODER = msgspec.json.Decoder(_UmeTrackLine)


def read_umetrack(path: Path) -> tuple[tuple[hot3d.HandRows, ...], tuple[str, ...]]:
    """Both hands over time, and remarks; lines that are no JSON are left out and counted.

    Raises:
        InputFileError: if the file is missing or holds no line at all, a pose is no pose, or time runs backwards.
    """
    lines, remarks = read_lines(path, _DECODER)
    hands = []
    for side in hot3d.HAND_KEYS:
        key = hot3d.HAND_KEYS[side]
        rows = [(line.timestamp_ns, line.hand_poses[key]) for line in lines if key in line.hand_poses]
        angles = np.zeros((len(rows), umetrack.N_JOINTS))
        for row, (time, hand) in enumerate(rows):
            count = min(len(hand.joint_angles), umetrack.N_JOINTS)
            if count < umetrack.N_ANGLES:
                raise InputFileError(
                    path, f"hand {key} at {time} ns", expected=f"{umetrack.N_ANGLES} joint angles", found=str(count)
                )
            angles[row, :count] = hand.joint_angles[:count]
        wrists = [(time, hand.wrist_xform) for time, hand in rows]
        hands.append(hand_rows(path, side, wrists, angles, np.empty(0)))
    return tuple(hands), remarks


def read_lines(path: Path, decoder: msgspec.json.Decoder[Any]) -> tuple[list[Any], tuple[str, ...]]:
    """Records of a file of JSON lines in the order of time, and a remark on those that do not parse.

    Raises:
        InputFileError: if the file is missing, no line parses, or time runs backwards.
    """
    records, bad = [], 0
    for line in _text_lines(path):
        try:
            records.append(decoder.decode(line))
        except (msgspec.DecodeError, UnicodeDecodeError):
            bad += 1
    if not records:
        raise InputFileError(
            path,
            "",
            expected="hand poses, one JSON object a line",
            found=f"{bad} lines that are none" if bad else "an empty file",
            remedy="metadata.json says that this ground truth is there; download the recording again.",
        )
    times = np.array([record.timestamp_ns for record in records], dtype=np.int64)
    require_increasing(path, times, unit="ns", place="record", first=1)
    return records, (f"{bad} of {bad + len(records)} lines of {path.name} are damaged and left out",) if bad else ()


def hand_rows(
    path: Path, side: Any, wrists: list[tuple[int, Any]], angles: np.ndarray, betas: np.ndarray
) -> hot3d.HandRows:
    """Rows of one hand, checked.

    Raises:
        InputFileError: for a pose that is no pose.
    """
    time_ns = np.array([time for time, _ in wrists], dtype=np.int64)
    position = np.array([wrist.t_xyz for _, wrist in wrists], dtype=np.float64).reshape(-1, 3)
    rotation = np.array([wrist.q_wxyz for _, wrist in wrists], dtype=np.float64).reshape(-1, 4)
    length = np.linalg.norm(rotation, axis=1)
    bad = ~(np.isfinite(position).all(axis=1) & np.isfinite(angles).all(axis=1))
    bad |= ~(np.abs(length - 1) <= _QUATERNION_TOLERANCE)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputFileError(
            path,
            f"{side} hand at {time_ns[row]} ns",
            expected="finite numbers and a quaternion of length 1",
            found=f"position {position[row].tolist()}, quaternion of length {length[row]:.4f}",
            remedy="Remove the line, or download the file again.",
        )
    return hot3d.HandRows(side, time_ns, position, rotation, angles, betas)


class _Model(msgspec.Struct):
    mesh_vertices: list[tuple[float, float, float]]
    mesh_triangles: list[tuple[float, float, float]]
    dense_bone_weights: list[list[float]]
    joint_rest_positions: list[tuple[float, float, float]]
    joint_rotation_axes: list[tuple[float, float, float]]
    landmark_rest_positions: list[tuple[float, float, float]]
    landmark_rest_bone_indices: list[tuple[int, int, int]]
    landmark_rest_bone_weights: list[tuple[float, float, float]]


class _Profile(msgspec.Struct):
    hand_model: _Model


_PROFILE = msgspec.json.Decoder(_Profile, strict=False)


def read_profile(path: Path) -> umetrack.HandModel:
    """The user's left hand, metres.

    Raises:
        InputFileError: if the file is missing or damaged, an array has another shape, or weights do not sum to 1.
    """
    model = decode_json(path, _PROFILE).hand_model
    _require_weights(path, model.dense_bone_weights)
    weights = np.array(model.dense_bone_weights, dtype=np.float64).reshape(-1, umetrack.N_BONES)
    shapes = {
        "dense_bone_weights": ((len(weights),), (max(len(model.mesh_vertices), 1),)),
        "joint_rest_positions": ((len(model.joint_rest_positions),), (umetrack.N_JOINTS,)),
        "joint_rotation_axes": ((len(model.joint_rotation_axes),), (umetrack.N_JOINTS,)),
        "landmark_rest_positions": ((len(model.landmark_rest_positions),), (umetrack.N_LANDMARKS,)),
    }
    for name, (found, expected) in shapes.items():
        if found != expected:
            raise InputFileError(path, name, expected=f"the shape {expected}", found=f"{found}")
    _require_places(path, model)
    return umetrack.HandModel(
        vertices=np.array(model.mesh_vertices) * umetrack.METRES_A_UNIT,
        weights=weights,
        joint_positions=np.array(model.joint_rest_positions) * umetrack.METRES_A_UNIT,
        joint_axes=np.array(model.joint_rotation_axes),
        landmarks=np.array(model.landmark_rest_positions) * umetrack.METRES_A_UNIT,
        landmark_weights=_dense(model.landmark_rest_bone_indices, model.landmark_rest_bone_weights),
        triangles=np.array(model.mesh_triangles, dtype=np.int64).reshape(-1, 3),
    )


def _require_weights(path: Path, rows: list[list[float]]) -> None:
    for row, weights in enumerate(rows):
        if len(weights) != umetrack.N_BONES or not abs(sum(weights) - 1) <= 1e-3:
            raise InputFileError(
                path,
                f"dense_bone_weights, row {row}",
                expected=f"{umetrack.N_BONES} numbers that sum to 1",
                found=f"{len(weights)} that sum to {sum(weights):g}",
            )


def _require_places(path: Path, model: _Model) -> None:
    """Refuse points far from any hand, and indices of bones or vertices that there are not."""
    for name in ("mesh_vertices", "joint_rest_positions", "joint_rotation_axes", "landmark_rest_positions"):
        if not (np.abs(np.array(getattr(model, name))) * umetrack.METRES_A_UNIT <= _FARTHEST).all():
            raise InputFileError(path, name, expected=f"points within {_FARTHEST:g} m of the wrist", found="others")
    for name, among in (
        ("landmark_rest_bone_indices", umetrack.N_BONES),
        ("mesh_triangles", len(model.mesh_vertices)),
    ):
        indices = np.array(getattr(model, name), dtype=np.float64)
        if not ((indices >= 0) & (indices < among)).all():
            raise InputFileError(path, name, expected=f"indices from 0 to {among - 1}", found="others")
    landmarks = len(model.landmark_rest_bone_indices), len(model.landmark_rest_bone_weights)
    if landmarks != (umetrack.N_LANDMARKS, umetrack.N_LANDMARKS):
        raise InputFileError(
            path,
            "landmark_rest_bone_indices",
            expected=f"{umetrack.N_LANDMARKS} of them and as many weights",
            found=f"{landmarks[0]} and {landmarks[1]}",
        )


def _dense(bones: list[tuple[int, int, int]], weights: list[tuple[float, float, float]]) -> np.ndarray:
    """Weights of all bones from (index, weight) triples; an index may stand there several times."""
    dense = np.zeros((len(bones), umetrack.N_BONES))
    rows = np.repeat(np.arange(len(bones)), 3)
    np.add.at(dense, (rows, np.array(bones).ravel()), np.array(weights, dtype=np.float64).ravel())
    return dense


def _text_lines(path: Path) -> Iterator[bytes]:
    try:
        with open_regular(path) as file:
            yield from (line for line in whole_lines(file, path) if line.strip())
    except FileNotFoundError as error:
        raise missing_file(path) from error
