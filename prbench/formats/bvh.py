"""BVH motion: hierarchy and channels, forward kinematics, and the 22 joints under the names that suits give them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.skeleton import N_JOINTS, Joint

POSITION_CHANNELS = ("Xposition", "Yposition", "Zposition")
ROTATION_CHANNELS = ("Xrotation", "Yrotation", "Zrotation")


@dataclass(frozen=True)
class BvhJoint:
    """One joint of the hierarchy; end sites are left out, they carry no motion."""

    name: str
    parent: int
    """Index of the parent; -1 for the root."""
    offset: tuple[float, float, float]
    """From the parent, in the parent's frame, file unit."""
    channels: tuple[str, ...]
    """In the order of the file."""


@dataclass(frozen=True)
class BvhMotion:
    """The content of one BVH file."""

    joints: tuple[BvhJoint, ...]
    """In the order of the hierarchy: parents before children."""
    frame_time: float
    """Seconds between two frames."""
    values: Float[np.ndarray, "n c"]
    """One row a frame, one column a channel; file unit and degrees."""


def joint_positions(motion: BvhMotion) -> Float[np.ndarray, "n j 3"]:
    """Positions of all joints in the frame and unit of the file.

    Rotations are applied in the order of their channels (``Z X Y`` means R = Rz Rx Ry). Position channels stand in for
    the offset of their joint; programs differ in whether a root's offset is added to them, which shifts the whole body.
    """
    rotations: list[Rotation] = []
    positions = np.empty((len(motion.values), len(motion.joints), 3))
    column = 0
    for index, joint in enumerate(motion.joints):
        values = motion.values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        local = _local_rotation(joint.channels, values)
        offset = np.tile(np.array(joint.offset), (len(values), 1))
        for place, channel in enumerate(joint.channels):
            if channel in POSITION_CHANNELS:
                offset[:, POSITION_CHANNELS.index(channel)] = values[:, place]
        if joint.parent < 0:
            positions[:, index] = offset
            rotations.append(local)
            continue
        parent = rotations[joint.parent]
        positions[:, index] = positions[:, joint.parent] + parent.apply(offset)
        rotations.append(parent * local)
    return positions


def _local_rotation(channels: tuple[str, ...], values: Float[np.ndarray, "n c"]) -> Rotation:
    turned = [(place, channel[0]) for place, channel in enumerate(channels) if channel in ROTATION_CHANNELS]
    if not turned:
        return Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (len(values), 1)))
    axes = "".join(axis for _, axis in turned)
    return Rotation.from_euler(axes, values[:, [place for place, _ in turned]], degrees=True)


class NameTable(NamedTuple):
    """One way of naming joints: for each of the 22 the names in use, written as :func:`normalised`."""

    convention: str
    names: tuple[tuple[str, ...], ...]


def _sides(*names: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return tuple(f"left{name}" for name in names), tuple(f"right{name}" for name in names)


def _table(convention: str, **paired: tuple[str, ...]) -> NameTable:
    names: list[tuple[str, ...]] = [()] * N_JOINTS
    names[Joint.PELVIS], names[Joint.NECK], names[Joint.HEAD] = ("hips", "hip", "pelvis", "root"), ("neck",), ("head",)
    names[Joint.SPINE1] = ("spine", "spine1")
    names[Joint.SPINE2] = ("spine1", "spine2")
    names[Joint.SPINE3] = ("spine2", "chest", "spine3", "upperchest")
    for part, alternatives in paired.items():
        left = Joint[f"LEFT_{part.upper()}"]
        names[left], names[left + 1] = _sides(*alternatives)
    return NameTable(convention, tuple(names))


NAME_TABLES: tuple[NameTable, ...] = (
    _table(
        "UpLeg, Leg, Foot, ToeBase; Shoulder, Arm, ForeArm, Hand",
        hip=("upleg", "upperleg", "thigh"),
        knee=("leg", "lowerleg", "shin"),
        ankle=("foot",),
        foot=("toebase", "toe", "toes"),
        collar=("shoulder", "collar", "clavicle"),
        shoulder=("arm", "uparm", "upperarm"),
        elbow=("forearm", "lowerarm"),
        wrist=("hand",),
    ),
    _table(
        "Hip, Knee, Ankle, Toe; Collar, Shoulder, Elbow, Wrist",
        hip=("hip",),
        knee=("knee",),
        ankle=("ankle",),
        foot=("foot", "toe", "toebase"),
        collar=("collar", "clavicle"),
        shoulder=("shoulder",),
        elbow=("elbow",),
        wrist=("wrist",),
    ),
)
"""Both meanings of ``Shoulder`` are in use, so names are looked up in one whole table at a time."""


def normalised(name: str) -> str:
    """A joint's name without prefix, case and separators: ``Character1:Left_Up-Leg``, ``L_UpLeg`` → ``leftupleg``."""
    plain = re.sub(r"[ _\-.]", "", re.sub(r"^(l|r)(?=[ _\-.])", _side, name.rsplit(":", 1)[-1].lower()))
    return re.sub(r"^mixamorig", "", plain)


def _side(match: re.Match[str]) -> str:
    return {"l": "left", "r": "right"}[match[1]]


class Matched(NamedTuple):
    """Which joints of a hierarchy are the 22."""

    columns: tuple[int, ...]
    """Index of each of the 22; -1 where no name matches."""
    unmatched: tuple[str, ...]
    """Names of joints of the file that are none of the 22."""
    convention: str


def match_names(joints: tuple[BvhJoint, ...]) -> Matched:
    """Find the 22 joints by name, in the table that knows most of them.

    A name that fits two places (``Spine1``) goes to the one whose other names are missing.
    """
    known = {normalised(joint.name): index for index, joint in reversed(list(enumerate(joints)))}
    best = max((_lookup(known, table) for table in NAME_TABLES), key=lambda found: sum(c >= 0 for c in found.columns))
    others = tuple(joint.name for index, joint in enumerate(joints) if index not in best.columns)
    return best._replace(unmatched=others)


def _lookup(known: dict[str, int], table: NameTable) -> Matched:
    columns: list[int] = []
    taken: set[int] = set()
    for names in table.names:
        index = next((known[name] for name in names if name in known and known[name] not in taken), -1)
        columns.append(index)
        taken.add(index)
    return Matched(tuple(columns), (), table.convention)
