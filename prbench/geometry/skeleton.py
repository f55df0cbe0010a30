"""The 22 joints and the names that other skeletons give them, the canonical frame, and worlds with Z up turned to Y up.

Joint order and frames follow HumanML3D: metres, Y up, right-handed; a body that faces +Z has its left side on +X.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from enum import IntEnum
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

# A quarter turn about X: (x, y, z) becomes (x, z, -y).
Y_UP_FROM_Z_UP = np.array([(1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, -1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)])
Y_UP_FROM_Z_UP.setflags(write=False)


def y_up(points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """(x, y, z) with Z up as (x, z, -y) with Y up, without rounding; the type of the numbers stays."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def z_up(points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Return the inverse of :func:`y_up`."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


class Joint(IntEnum):
    """The 22 SMPL body joints in HumanML3D order."""

    PELVIS = 0
    LEFT_HIP = 1
    RIGHT_HIP = 2
    SPINE1 = 3
    LEFT_KNEE = 4
    RIGHT_KNEE = 5
    SPINE2 = 6
    LEFT_ANKLE = 7
    RIGHT_ANKLE = 8
    SPINE3 = 9
    LEFT_FOOT = 10
    RIGHT_FOOT = 11
    NECK = 12
    LEFT_COLLAR = 13
    RIGHT_COLLAR = 14
    HEAD = 15
    LEFT_SHOULDER = 16
    RIGHT_SHOULDER = 17
    LEFT_ELBOW = 18
    RIGHT_ELBOW = 19
    LEFT_WRIST = 20
    RIGHT_WRIST = 21


N_JOINTS = len(Joint)
JOINT_SET = "humanml3d-22"

# Parent of each joint; -1 for the pelvis.
PARENTS: tuple[int, ...] = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)

# Kinematic chains in the order of the HumanML3D features: right leg, left leg, trunk, right arm, left arm.
CHAINS: tuple[tuple[int, ...], ...] = (
    (0, 2, 5, 8, 11),
    (0, 1, 4, 7, 10),
    (0, 3, 6, 9, 12, 15),
    (9, 14, 17, 19, 21),
    (9, 13, 16, 18, 20),
)

# (parent, child) of the 21 bones, in the order of the child.
BONES: tuple[tuple[int, int], ...] = tuple((PARENTS[child], child) for child in range(1, N_JOINTS))

WRISTS: tuple[int, int] = (Joint.LEFT_WRIST, Joint.RIGHT_WRIST)
TOES: tuple[int, int] = (Joint.LEFT_FOOT, Joint.RIGHT_FOOT)

_LYING_SIDEWAYS = 0.1  # sine of the angle between shoulder axis and neck-head bone below which no frame is defined
_SHORTEST_NECK = 0.01  # metres
_ROUNDING = 1e-12  # metres, or of a unit vector


def bone_lengths(joints: Float[np.ndarray, "*batch 22 3"]) -> Float[np.ndarray, "*batch 21"]:
    """Lengths of the 21 bones in the order of :data:`BONES`, metres."""
    parents, children = np.transpose(BONES)
    return np.linalg.norm(joints[..., children, :] - joints[..., parents, :], axis=-1)


def facing_yaw(joints: Float[np.ndarray, "22 3"]) -> float:
    """Heading of a pose about +Y, radians: 0 faces +Z, positive turns towards +X.

    The facing direction is Y x across with across = (right hip - left hip) + (right shoulder - left shoulder)
    (docs/specification/humanml3d.md#forward-conversion, step 4). A pose that faces exactly -Z gets a yaw of pi, not
    NaN.

    Raises:
        ValueError: if hips and shoulders stand exactly above one another, so that no heading exists.
    """
    across = joints[Joint.RIGHT_HIP] - joints[Joint.LEFT_HIP]
    across = across + joints[Joint.RIGHT_SHOULDER] - joints[Joint.LEFT_SHOULDER]
    forward_x = across[2]  # Y x across
    forward_z = -across[0]
    if np.hypot(forward_x, forward_z) < 1e-9:
        raise ValueError("the pose has no heading: hips and shoulders lie on one vertical line")
    return float(np.arctan2(forward_x, forward_z))


def canonical_frame(joints: Float[np.ndarray, "frames 22 3"]) -> Float[np.ndarray, "4 4"]:
    """``world_from_canonical`` of a motion: pelvis of frame 0 over the origin facing +Z, lowest joint at Y = 0.

    The rotation is a pure yaw, so gravity keeps its direction. "Lowest" means over all joints and all frames
    (docs/specification/humanml3d.md#forward-conversion, steps 2 to 4).

    Args:
        joints: World frame, metres, Y up.

    Returns:
        Rigid transform; maps canonical coordinates into the world.
    """
    yaw = facing_yaw(joints[0])
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    pelvis = joints[0, Joint.PELVIS]
    world_from_canonical = np.eye(4)
    world_from_canonical[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
    world_from_canonical[:3, 3] = pelvis[0], joints[..., 1].min(), pelvis[2]
    return world_from_canonical


def transform_points(a_from_b: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*batch 3"]) -> np.ndarray:
    """Points given in frame b, expressed in frame a.

    Written out axis by axis: a matrix product may round differently with another number of threads or rows.
    """
    x = points[..., 0:1]
    y = points[..., 1:2]
    z = points[..., 2:3]
    return x * a_from_b[:3, 0] + y * a_from_b[:3, 1] + z * a_from_b[:3, 2] + a_from_b[:3, 3]


def invert_rigid(a_from_b: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """``b_from_a`` of a rotation with translation."""
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = a_from_b[:3, :3].T
    b_from_a[:3, 3] = -a_from_b[:3, :3].T @ a_from_b[:3, 3]
    return b_from_a


def rotation_matrices(quaternions: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrices of unit quaternions, w x y z."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def forward_kinematics(
    offsets: Float[np.ndarray, "joints 3"],
    root: Float[np.ndarray, "n 3"],
    local: Float[np.ndarray, "n joints 3 3"],
    parents: Sequence[int],
) -> tuple[Float[np.ndarray, "n joints 3"], Float[np.ndarray, "n joints 3 3"]]:
    """Positions and world rotations of a skeleton whose joints turn in their parents.

    Args:
        offsets: Place of each joint in its parent's frame; that of joint 0 is not used.
        root: Position of joint 0 in the world, same unit.
        local: Rotation of each joint in its parent; that of joint 0 in the world. NaN gives NaN.
        parents: Parent of each joint, parents before children.
    """
    positions = np.empty((*local.shape[:2], 3))
    rotations = np.empty(local.shape)
    positions[:, 0] = root
    rotations[:, 0] = local[:, 0]
    for joint in range(1, len(offsets)):
        parent = parents[joint]
        positions[:, joint] = positions[:, parent] + rotations[:, parent] @ offsets[joint]
        rotations[:, joint] = rotations[:, parent] @ local[:, joint]
    return positions, rotations


def head_forward(
    joints: Float[np.ndarray, "*batch 22 3"], head_tilt_deg: float | Float[np.ndarray, "*batch"]
) -> tuple[Float[np.ndarray, "*batch 3"], Bool[np.ndarray, "*batch"]]:
    """Head-forward vector H from the joints alone (docs/specification/humanml3d.md#head-forward-vector).

    With h the unit vector neck to head and a the left-pointing shoulder axis made orthogonal to h,
    ``H = cos(tilt) (a x h) + sin(tilt) h``; its ray starts at the head joint.

    Args:
        joints: Any frame with Y up, metres.
        head_tilt_deg: Rest tilt of the neck-head bone from the vertical, towards the front, degrees; a constant of
            the skeleton that the pose came from (column ``head_tilt_deg`` of the sequence table). Broadcasts against
            the leading axes of ``joints``.

    Returns:
        Unit vectors, and a mask of degenerate poses: shoulder axis within about 6 degrees of the neck-head bone (lying
        sideways), or head within 1 cm of the neck. Degenerate poses take the torso (pelvis to neck) as their vertical.
        Poses without any torso or shoulder axis have H = 0.
    """
    neck = joints[..., Joint.NECK, :]
    head = joints[..., Joint.HEAD, :]
    shoulders = joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :]
    up, neck_length = _normalised(head - neck)
    left, sine = _orthogonal_part(shoulders, up)
    degenerate = np.asarray((neck_length < _SHORTEST_NECK) | (sine < _LYING_SIDEWAYS))
    if degenerate.any():
        torso_up, _ = _normalised(neck - joints[..., Joint.PELVIS, :])
        torso_left, _ = _orthogonal_part(shoulders, torso_up)
        up = np.where(degenerate[..., None], torso_up, up)
        left = np.where(degenerate[..., None], torso_left, left)
    tilt = np.where(degenerate, 0.0, np.deg2rad(np.asarray(head_tilt_deg, dtype=np.float64)))[..., None]
    return np.cos(tilt) * np.cross(left, up) + np.sin(tilt) * up, degenerate


def _normalised(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors and lengths; a vector that is nothing but rounding stays next to zero."""
    length = np.asarray(np.linalg.norm(vectors, axis=-1))
    return vectors / np.where(length > _ROUNDING, length, 1.0)[..., None], length


def _orthogonal_part(vectors: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit part of ``vectors`` orthogonal to the unit ``axis``, and the sine of the angle between them."""
    unit, _ = _normalised(vectors)
    return _normalised(unit - (unit * axis).sum(axis=-1, keepdims=True) * axis)


# The 23 segments of an Xsens suit in file order; a segment's position is its joint nearest to the pelvis.
XSENS_SEGMENTS = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head",
    "R_Shoulder", "R_UpperArm", "R_Forearm", "R_Hand",
    "L_Shoulder", "L_UpperArm", "L_Forearm", "L_Hand",
    "R_UpperLeg", "R_LowerLeg", "R_Foot", "R_Toe",
    "L_UpperLeg", "L_LowerLeg", "L_Foot", "L_Toe",
)  # fmt: skip


def match_names(joints: Sequence[str]) -> tuple[tuple[int, ...], tuple[str, ...], str]:
    """Find the 22 joints by name, in the table that knows most of them.

    A name that fits two places (``Spine1``) goes to the one whose other names are missing.

    Args:
        joints: Names of the source's joints in its order, with any prefix, case and separators.

    Returns:
        Index of each of the 22 among ``joints`` (-1 where no name matches), the names that are none of the 22, and the
        naming convention of the table.
    """
    # From the last to the first: of two joints with one name the first counts.
    known = {normalised(name): index for index, name in reversed(list(enumerate(joints)))}
    best: list[int] = []
    best_convention = ""
    for convention, table in _NAME_TABLES.items():
        columns: list[int] = []
        for names in table:
            columns.append(next((known[name] for name in names if name in known and known[name] not in columns), -1))
        if not best or columns.count(-1) < best.count(-1):
            best = columns
            best_convention = convention
    return tuple(best), tuple(name for index, name in enumerate(joints) if index not in best), best_convention


_SIDES = {"l": "left", "r": "right"}


def normalised(name: str) -> str:
    """Return a joint name without prefix, case, separators: ``Character1:Left_Up-Leg``, ``L_UpLeg`` → ``leftupleg``."""
    own = name.rsplit(":", 1)[-1].lower()
    sided = re.sub(r"^(l|r)(?=[ _\-.])", lambda match: _SIDES[match[1]], own)
    return re.sub(r"^mixamorig", "", re.sub(r"[ _\-.]", "", sided))


def _names_of(joint: Joint, sides: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return the names in use of one of the 22, written as :func:`normalised`."""
    side, _, part = joint.name.lower().partition("_")
    return tuple(f"{side}{name}" for name in sides[part]) if part else tuple(_JOINT_NAMES["trunk"][side])


# The names that animation software gives the 22; the file explains its tables.
_JOINT_NAMES = tomllib.loads(Path(__file__).with_name("joint_names.toml").read_text("utf-8"))
_NAME_TABLES = {
    convention: tuple(_names_of(joint, sides) for joint in Joint) for convention, sides in _JOINT_NAMES["sides"].items()
}
