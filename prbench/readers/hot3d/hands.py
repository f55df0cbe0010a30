"""Hands of HOT3D: UmeTrack's poses line by line, and the user's hand model (docs/specification/hot3d.md#files)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.bounded import open_regular, require, whole_lines
from prbench.readers import files as native
from prbench.readers.hot3d import format as hot3d
from prbench.recording import UnreadableEntry

N_JOINTS = 22
N_ANGLES = 20  # Angles that move bones; joints 20 and 21 are unused.
_N_FINGERS = 5
JOINTS_A_FINGER = 4
_BONES_A_FINGER = 3
N_BONES = 2 + _N_FINGERS * _BONES_A_FINGER  # Root and wrist, which never move, then three a finger, thumb to little.
N_LANDMARKS = 21
METRES_A_UNIT = 1e-3
_QUATERNION_TOLERANCE = 1e-3
_FARTHEST = 1.0  # metres from the wrist, many times as long as a hand


class _Wrist(msgspec.Struct):
    t_xyz: tuple[native.Metres, native.Metres, native.Metres]
    q_wxyz: tuple[float, float, float, float]


class _UmeTrackHand(msgspec.Struct):
    wrist_xform: _Wrist
    joint_angles: tuple[float, ...]

    def __post_init__(self) -> None:
        length = math.hypot(*self.wrist_xform.q_wxyz)
        if abs(length - 1) > _QUATERNION_TOLERANCE:
            raise ValueError(f"a quaternion of length {length:.4f}")
        if len(self.joint_angles) < N_ANGLES:
            raise ValueError(f"{len(self.joint_angles)} angles")


class _UmeTrackLine(msgspec.Struct):
    timestamp_ns: native.Nanoseconds
    hand_poses: dict[str, msgspec.Raw]


class _Model(msgspec.Struct):
    mesh_vertices: list[tuple[float, float, float]]
    dense_bone_weights: list[list[float]]
    joint_rest_positions: list[tuple[float, float, float]]
    joint_rotation_axes: list[tuple[float, float, float]]


def bone_transforms(model: hot3d.HandModel, angles: Float[np.ndarray, "n 22"]) -> Float[np.ndarray, "n 17 4 4"]:
    """Return the pose of every bone in the frame of the wrist, relative to its rest.

    Args:
        model: Joints and axes.
        angles: Radians; the first 20 count.
    """
    turned = []
    for axis, point, angle in zip(model.joint_axes, model.joint_positions, angles.T[:N_ANGLES]):
        # A rotation about an axis through a point.
        transform = np.tile(np.eye(4), (len(angles), 1, 1))
        transform[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
        transform[:, :3, 3] = point - transform[:, :3, :3] @ point
        turned.append(transform)
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


def pose_points(
    points: Float[np.ndarray, "v 3"],
    weights: Float[np.ndarray, "v 17"],
    bones: Float[np.ndarray, "n 17 4 4"],
    wrist_position: Float[np.ndarray, "n 3"],
    wrist_rotation: Float[np.ndarray, "n 4"],
    *,
    mirrored: bool,
) -> Float[np.ndarray, "n v 3"]:
    """Return the world positions of points of the hand: linear blend skinning, then the wrist's pose.

    Args:
        points: Points of the hand at rest, in the frame of the wrist, metres.
        weights: Share of each bone.
        bones: See :func:`bone_transforms`.
        wrist_position: Position of the wrist in the world, metres.
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


def read_umetrack(path: Path) -> tuple[tuple[hot3d.HandRows, ...], list[UnreadableEntry]]:
    """Read both hands over time, and tell lines and hands that cannot be read.

    Raises:
        InputFileError: if the file is missing or holds no line at all, or time runs backwards.
    """
    with native.must_exist(path), open_regular(path) as file:
        numbered = enumerate(whole_lines(file, path), start=1)
        entries = {f"line {number}": line for number, line in numbered if line.strip()}
    decode = msgspec.json.Decoder(_UmeTrackLine).decode
    lines, odd = native.read_entries(path, entries, decode, "timestamp_ns and hand_poses")
    unreadable = native.told_together(odd)
    expected = "hand poses, one JSON object a line"
    remedy = "metadata.json says that this ground truth is there; download the recording again."
    require(path, (len(lines) > 0, "", expected, f"{len(odd)} lines that are none" if odd else "an empty file", remedy))
    times = np.array([line.timestamp_ns for line in lines.values()], dtype=np.int64)
    native.require_increasing(path, times, unit="ns", place="record", first=1)
    hands = []
    for side, key in hot3d.HAND_KEYS.items():
        seen = {f"{place}, {side} hand": row.hand_poses[key] for place, row in lines.items() if key in row.hand_poses}
        expected = f"finite numbers, {N_ANGLES} joint angles and a quaternion of length 1"
        poses, odd = native.read_entries(path, seen, msgspec.json.Decoder(_UmeTrackHand).decode, expected)
        unreadable += native.told_together(odd)
        time_ns = np.array([lines[place.partition(",")[0]].timestamp_ns for place in poses], dtype=np.int64)
        wrists = [pose.wrist_xform for pose in poses.values()]
        position = np.array([wrist.t_xyz for wrist in wrists], dtype=np.float64).reshape(-1, 3)
        rotation = np.array([wrist.q_wxyz for wrist in wrists], dtype=np.float64).reshape(-1, 4)
        angles = np.zeros((len(poses), N_JOINTS))
        for row, pose in enumerate(poses.values()):
            given = pose.joint_angles[:N_JOINTS]
            angles[row, : len(given)] = given
        hands.append(hot3d.HandRows(side, time_ns, position, rotation, angles))
    return tuple(hands), unreadable


def read_profile(path: Path) -> hot3d.HandModel:
    """Read the user's left hand, metres.

    Raises:
        InputFileError: if the file is missing or damaged, an array has another shape, or weights do not sum to 1.
    """
    profile = native.decode_json(path, dict[Literal["hand_model"], _Model], strict=False)
    require(path, ("hand_model" in profile, "", "the key 'hand_model'", "an empty object", "Download it again."))
    model = profile["hand_model"]
    for row, weights in enumerate(model.dense_bone_weights):
        found = f"{len(weights)} that sum to {sum(weights):g}"
        is_fine = len(weights) == N_BONES and abs(sum(weights) - 1) <= 1e-3
        require(path, (is_fine, f"dense_bone_weights, row {row}", f"{N_BONES} numbers that sum to 1", found, ""))
    vertices = max(len(model.mesh_vertices), 1)
    for name, rows in (
        ("dense_bone_weights", vertices),
        ("mesh_vertices", vertices),
        ("joint_rest_positions", N_JOINTS),
        ("joint_rotation_axes", N_JOINTS),
    ):
        found = getattr(model, name)
        if len(found) != rows:
            raise InputFileError(path, name, expected=f"{rows} rows", found=str(len(found)))
        # Points far from any hand are refused; weights and axes are far smaller.
        if not (np.abs(np.array(found)) * METRES_A_UNIT <= _FARTHEST).all():
            raise InputFileError(path, name, expected=f"points within {_FARTHEST:g} m of the wrist", found="others")
    placed, joints = (np.array(points) * METRES_A_UNIT for points in (model.mesh_vertices, model.joint_rest_positions))
    shares = np.array(model.dense_bone_weights, dtype=np.float64)
    return hot3d.HandModel(placed, shares, joints, np.array(model.joint_rotation_axes))
