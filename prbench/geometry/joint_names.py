"""Names that other skeletons give to the 22 joints: BVH conventions, and the segments of the Xsens suit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from prbench.geometry.skeleton import N_JOINTS, Joint

XSENS_SEGMENTS = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head",
    "R_Shoulder", "R_UpperArm", "R_Forearm", "R_Hand",
    "L_Shoulder", "L_UpperArm", "L_Forearm", "L_Hand",
    "R_UpperLeg", "R_LowerLeg", "R_Foot", "R_Toe",
    "L_UpperLeg", "L_LowerLeg", "L_Foot", "L_Toe",
)  # fmt: skip
"""The 23 segments of an Xsens suit in file order; a segment's position is its joint nearest to the pelvis."""


class NameTable(NamedTuple):
    """One way of naming joints: for each of the 22 the names in use, written as :func:`normalised`."""

    convention: str
    names: tuple[tuple[str, ...], ...]


class Matched(NamedTuple):
    """The joints of a hierarchy that are the 22."""

    columns: tuple[int, ...]
    """Index of each of the 22; -1 where no name matches."""
    unmatched: tuple[str, ...]
    """Names of joints of the file that are none of the 22."""
    convention: str


def match_names(joints: Sequence[str]) -> Matched:
    """Find the 22 joints by name, in the table that knows most of them.

    A name that fits two places (``Spine1``) goes to the one whose other names are missing.

    Args:
        joints: Names of the source's joints in its order, with any prefix, case and separators.
    """
    # From the last to the first: of two joints with one name the first counts.
    known = {normalised(name): index for index, name in reversed(list(enumerate(joints)))}
    best = max((_lookup(known, table) for table in _NAME_TABLES), key=lambda found: sum(c >= 0 for c in found.columns))
    others = tuple(name for index, name in enumerate(joints) if index not in best.columns)
    return best._replace(unmatched=others)


def normalised(name: str) -> str:
    """A joint's name without prefix, case and separators: ``Character1:Left_Up-Leg``, ``L_UpLeg`` → ``leftupleg``."""
    plain = re.sub(r"[ _\-.]", "", re.sub(r"^(l|r)(?=[ _\-.])", _side, name.rsplit(":", 1)[-1].lower()))
    return re.sub(r"^mixamorig", "", plain)


def _side(match: re.Match[str]) -> str:
    return {"l": "left", "r": "right"}[match[1]]


def _lookup(known: dict[str, int], table: NameTable) -> Matched:
    columns: list[int] = []
    taken: set[int] = set()
    for names in table.names:
        index = next((known[name] for name in names if name in known and known[name] not in taken), -1)
        columns.append(index)
        taken.add(index)
    return Matched(tuple(columns), (), table.convention)


def _table(convention: str, **paired: tuple[str, ...]) -> NameTable:
    names: list[tuple[str, ...]] = [()] * N_JOINTS
    names[Joint.PELVIS] = ("hips", "hip", "pelvis", "root")
    names[Joint.NECK] = ("neck",)
    names[Joint.HEAD] = ("head",)
    names[Joint.SPINE1] = ("spine", "spine1")
    names[Joint.SPINE2] = ("spine1", "spine2")
    names[Joint.SPINE3] = ("spine2", "chest", "spine3", "upperchest")
    for part, alternatives in paired.items():
        left = Joint[f"LEFT_{part.upper()}"]
        # In HumanML3D's order every right joint follows its left one.
        names[left], names[left + 1] = _sides(*alternatives)
    return NameTable(convention, tuple(names))


def _sides(*names: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return tuple(f"left{name}" for name in names), tuple(f"right{name}" for name in names)


_NAME_TABLES: tuple[NameTable, ...] = (
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
