"""Hands of HOT3D: UmeTrack's poses line by line, and the user's hand model (docs/specification/hot3d.md#files)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.readers.files import Nanoseconds, decode_json, require_increasing, text_lines
from prbench.readers.hot3d import format as hot3d

N_JOINTS = 22
N_ANGLES = 20
"""Angles that move bones; joints 20 and 21 are unused."""
_N_FINGERS = 5
JOINTS_A_FINGER = 4
_BONES_A_FINGER = 3
N_BONES = 2 + _N_FINGERS * _BONES_A_FINGER
"""Root and wrist, which never move, then three a finger, thumb to little."""
N_LANDMARKS = 21
WRIST_LANDMARK = 5
PALM_LANDMARK = 20
METRES_A_UNIT = 1e-3
_QUATERNION_TOLERANCE = 1e-3
_FARTHEST = 1.0  # metres from the wrist, many times as long as a hand


class Wrist(msgspec.Struct):
    """Pose of a wrist in either kind of file."""

    t_xyz: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]


class _UmeTrackHand(msgspec.Struct):
    wrist_xform: Wrist
    joint_angles: tuple[float, ...]


class _UmeTrackLine(msgspec.Struct):
    timestamp_ns: Nanoseconds
    hand_poses: dict[str, _UmeTrackHand]


_UMETRACK_DECODER = msgspec.json.Decoder(_UmeTrackLine)


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


def bone_transforms(model: hot3d.HandModel, angles: Float[np.ndarray, "n 22"]) -> Float[np.ndarray, "n 17 4 4"]:
    """Return the pose of every bone in the frame of the wrist, relative to its rest.

    Args:
        model: Joints and axes.
        angles: Radians; the first 20 count.
    """
    turned = [
        _about(model.joint_axes[joint], model.joint_positions[joint], angles[:, joint]) for joint in range(N_ANGLES)
    ]
    # Root and wrist: neither moves in the frame of the wrist.
    bones = [np.broadcast_to(np.eye(4), (len(angles), 4, 4))] * 2
    for finger in range(_N_FINGERS):
        first = finger * JOINTS_A_FINGER
        # A finger has four joints and three bones: its first two joints turn the first bone.
        bone = turned[first]
        for joint in range(first + 1, first + JOINTS_A_FINGER):
            bone = bone @ turned[joint]
            bones.append(bone)
    return np.stack(bones, axis=1)


def _about(
    axis: Float[np.ndarray, "3"], point: Float[np.ndarray, "3"], angles: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4 4"]:
    """Rotations about an axis through a point."""
    transform = np.tile(np.eye(4), (len(angles), 1, 1))
    transform[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    transform[:, :3, 3] = point - transform[:, :3, :3] @ point
    return transform


def pose_points(
    points: Float[np.ndarray, "v 3"],
    weights: Float[np.ndarray, "v 17"],
    bones: Float[np.ndarray, "n 17 4 4"],
    wrist_position: Float[np.ndarray, "n 3"],
    wrist_rotation: Float[np.ndarray, "n 4"],
    *,
    mirrored: bool,
) -> Float[np.ndarray, "n v 3"]:
    """World positions of points of the hand: linear blend skinning, then the wrist's pose.

    Args:
        points: At rest, in the frame of the wrist.
        weights: Share of each bone.
        bones: See :func:`bone_transforms`.
        wrist_position: In the world, metres.
        wrist_rotation: Wrist to world, w x y z.
        mirrored: Whether it is a right hand: the first column of the rotation is negated.
    """
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    # Weight times point is a constant of the model, so that one product poses all frames at once.
    carried = (weights[:, :, None] * homogeneous[:, None, :]).reshape(len(points), -1)
    flat = bones[:, :, :3].transpose(0, 1, 3, 2).reshape(len(bones), -1, 3)
    matrix = Rotation.from_quat(wrist_rotation, scalar_first=True).as_matrix()
    # The model is a left hand; the file's rotation of a right one refers to its mirror image.
    if mirrored:
        matrix = matrix * np.array([-1.0, 1.0, 1.0])
    return carried @ (flat @ matrix.transpose(0, 2, 1)) + wrist_position[:, None]


def read_umetrack(path: Path) -> tuple[tuple[hot3d.HandRows, ...], tuple[str, ...]]:
    """Both hands over time, and remarks; lines that are no JSON are left out and counted.

    Raises:
        InputFileError: if the file is missing or holds no line at all, a pose is no pose, or time runs backwards.
    """
    lines, remarks = read_lines(path, _UMETRACK_DECODER)
    hands = []
    for side in hot3d.HAND_KEYS:
        key = hot3d.HAND_KEYS[side]
        rows = [(line.timestamp_ns, line.hand_poses[key]) for line in lines if key in line.hand_poses]
        angles = np.zeros((len(rows), N_JOINTS))
        for row, (time, hand) in enumerate(rows):
            count = min(len(hand.joint_angles), N_JOINTS)
            if count < N_ANGLES:
                raise InputFileError(
                    path, f"hand {key} at {time} ns", expected=f"{N_ANGLES} joint angles", found=str(count)
                )
            angles[row, :count] = hand.joint_angles[:count]
        wrists = [(time, hand.wrist_xform) for time, hand in rows]
        hands.append(hand_rows(path, side, wrists, angles))
    return tuple(hands), remarks


def read_lines(path: Path, decoder: msgspec.json.Decoder[Any]) -> tuple[list[Any], tuple[str, ...]]:
    """Records of a file of JSON lines in the order of time, and a remark on those that do not parse.

    Raises:
        InputFileError: if the file is missing, no line parses, or time runs backwards.
    """
    records = []
    bad = 0
    for _, line in text_lines(path):
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


def hand_rows(path: Path, side: Any, wrists: list[tuple[int, Any]], angles: np.ndarray) -> hot3d.HandRows:
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
    return hot3d.HandRows(side, time_ns, position, rotation, angles)


def read_profile(path: Path) -> hot3d.HandModel:
    """The user's left hand, metres.

    Raises:
        InputFileError: if the file is missing or damaged, an array has another shape, or weights do not sum to 1.
    """
    model = decode_json(path, _PROFILE).hand_model
    for row, weights in enumerate(model.dense_bone_weights):
        if len(weights) != N_BONES or not abs(sum(weights) - 1) <= 1e-3:
            raise InputFileError(
                path,
                f"dense_bone_weights, row {row}",
                expected=f"{N_BONES} numbers that sum to 1",
                found=f"{len(weights)} that sum to {sum(weights):g}",
            )
    weights = np.array(model.dense_bone_weights, dtype=np.float64).reshape(-1, N_BONES)
    shapes = {
        "dense_bone_weights": ((len(weights),), (max(len(model.mesh_vertices), 1),)),
        "joint_rest_positions": ((len(model.joint_rest_positions),), (N_JOINTS,)),
        "joint_rotation_axes": ((len(model.joint_rotation_axes),), (N_JOINTS,)),
        "landmark_rest_positions": ((len(model.landmark_rest_positions),), (N_LANDMARKS,)),
    }
    for name, (found, expected) in shapes.items():
        if found != expected:
            raise InputFileError(path, name, expected=f"the shape {expected}", found=f"{found}")
    # Refuse points far from any hand, and indices of bones or vertices that there are not.
    for name in ("mesh_vertices", "joint_rest_positions", "joint_rotation_axes", "landmark_rest_positions"):
        if not (np.abs(np.array(getattr(model, name))) * METRES_A_UNIT <= _FARTHEST).all():
            raise InputFileError(path, name, expected=f"points within {_FARTHEST:g} m of the wrist", found="others")
    for name, among in (
        ("landmark_rest_bone_indices", N_BONES),
        ("mesh_triangles", len(model.mesh_vertices)),
    ):
        indices = np.array(getattr(model, name), dtype=np.float64)
        if not ((indices >= 0) & (indices < among)).all():
            raise InputFileError(path, name, expected=f"indices from 0 to {among - 1}", found="others")
    landmarks = len(model.landmark_rest_bone_indices), len(model.landmark_rest_bone_weights)
    if landmarks != (N_LANDMARKS, N_LANDMARKS):
        raise InputFileError(
            path,
            "landmark_rest_bone_indices",
            expected=f"{N_LANDMARKS} of them and as many weights",
            found=f"{landmarks[0]} and {landmarks[1]}",
        )
    return hot3d.HandModel(
        vertices=np.array(model.mesh_vertices) * METRES_A_UNIT,
        weights=weights,
        joint_positions=np.array(model.joint_rest_positions) * METRES_A_UNIT,
        joint_axes=np.array(model.joint_rotation_axes),
        landmarks=np.array(model.landmark_rest_positions) * METRES_A_UNIT,
        landmark_weights=_dense(model.landmark_rest_bone_indices, model.landmark_rest_bone_weights),
        triangles=np.array(model.mesh_triangles, dtype=np.int64).reshape(-1, 3),
    )


def _dense(bones: list[tuple[int, int, int]], weights: list[tuple[float, float, float]]) -> np.ndarray:
    """Weights of all bones from (index, weight) triples; an index may stand there several times."""
    dense = np.zeros((len(bones), N_BONES))
    rows = np.repeat(np.arange(len(bones)), 3)
    np.add.at(dense, (rows, np.array(bones).ravel()), np.array(weights, dtype=np.float64).ravel())
    return dense
