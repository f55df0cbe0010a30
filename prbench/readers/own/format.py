"""The plain recording: ``recording.toml``, the names of its tables and their columns (docs/own-recordings.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import msgspec

from prbench.representation.converters import JOINT_MAPS, JointMap, joint_map

ABOUT_FILE = "recording.toml"
# Endings of a table's file; a recording has at most one file for each table.
SUFFIXES = (".parquet", ".csv")
# Seconds a unit.
TIME_UNITS = MappingProxyType({"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9})
# Metres a unit.
LENGTH_UNITS = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001})
# Name of the 22 joints beside that of the converters.
SMPL_22 = "smpl22"

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of everything in ``recording.toml``."""


class Units(_Part, kw_only=True):
    """Units of all lengths and of all times in the tables."""

    length: Literal["m", "cm", "mm"]
    time: Literal["s", "ms", "us", "ns"]


class Axes(_Part, kw_only=True):
    """The world of the tables.

    Attributes:
        up: Axis that points up.
        quaternion: Order in which the columns ``qw``, ``qx``, ``qy`` and ``qz`` stand in each table.
        handed: Handedness of the axes; ``left`` in Unity and Unreal.
    """

    up: Axis
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    handed: Literal["right", "left"] = "right"


class HeadAxes(_Part, kw_only=True):
    """The axes of the head's pose that point where the face does, and up."""

    forward: Axis = "z"
    up: Axis = "y"


class GazeFrame(_Part, kw_only=True):
    """The frame of gaze: the world, or the axes of the head's pose."""

    frame: Literal["world", "head"] = "world"


class Video(_Part, kw_only=True):
    """Time of frame 0 on the clock of the tables, in their unit, and frames a second."""

    start: float = 0.0
    fps: float


class Body(_Part, kw_only=True):
    """Name of the body's skeleton, and what measured or estimated it."""

    skeleton: str = SMPL_22
    source: str = ""

    @property
    def map(self) -> JointMap:
        """Return the map of its joints to the 22.

        Raises:
            UsageError: for an unknown skeleton, with the nearest known one.
        """
        return JOINT_MAPS["humanml3d-22"] if self.skeleton == SMPL_22 else joint_map(self.skeleton)


class About(_Part, kw_only=True):
    """The content of ``recording.toml``.

    Attributes:
        participant: Name of the person; recordings of one person are kept together where splits are drawn.
        video: None where events have times and no frames.
    """

    version: Literal[1] = 1
    participant: str
    units: Units
    axes: Axes
    head: HeadAxes = HeadAxes()
    gaze: GazeFrame = GazeFrame()
    video: Video | None = None
    body: Body = Body()


POINT = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
BOX = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
# Columns of text; all others hold numbers.
TEXTS = frozenset({"side", "object_id", "name", "category", "movable", "action", "object", "hand"})


@dataclass(frozen=True)
class Columns:
    """The columns of one table: those that it must have, and groups that are there together or not at all."""

    required: tuple[str, ...]
    optional: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return all of them."""
        return (*self.required, *(name for group in self.optional for name in group))


# Words that a column of text may hold; the empty one where nothing is stated.
WORDS = MappingProxyType({"side": ("left", "right"), "movable": ("true", "false", "yes", "no", "1", "0", "")})
# Form of a body's source, which becomes a part of the names of sequences.
SOURCE = re.compile(r"[a-z0-9-]*")

# The body's columns are named after the joints of its skeleton: ``<joint>_x``.
TABLES: Mapping[str, Columns] = MappingProxyType(
    {
        "head": Columns(("time", *POINT, *QUATERNION)),
        "gaze": Columns(("time", "dx", "dy", "dz"), (("ox", "oy", "oz"),)),
        "wrists": Columns(("time", "side", *POINT), (QUATERNION,)),
        "body": Columns(("time",)),
        "objects": Columns(("object_id", "name"), (("category",), ("movable",), BOX)),
        "object_poses": Columns(("time", "object_id", *POINT), (QUATERNION,)),
        "events": Columns(("action", "object"), (("time",), ("frame",), POINT, BOX, ("hand",))),
    }
)


def body_columns(skeleton: JointMap) -> tuple[str, ...]:
    """Return the columns of a skeleton's joints, in the order of its arrays."""
    return tuple(f"{joint}_{axis}" for joint in skeleton.source_joints for axis in POINT)


def columns_of(table: str, about: About) -> Columns:
    """Return the columns of one table of a recording."""
    joints = body_columns(about.body.map) if table == "body" else ()
    return Columns((*TABLES[table].required, *joints), TABLES[table].optional)
