"""The plain recording: ``recording.toml``, the names of its tables and their columns (docs/own-recordings.md)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import did_you_mean
from prbench.representation.converters import JOINT_MAPS, JointMap, to_y_up

ABOUT_FILE = "recording.toml"
# Endings of a table's file; a recording has at most one file for each table.
SUFFIXES = (".parquet", ".csv")
# Seconds a unit.
TIME_UNITS = MappingProxyType({"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9})
# Metres a unit.
LENGTH_UNITS = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001})
# Skeletons by the names that converters use; the 22 joints have another one, too.
SKELETONS: Mapping[str, JointMap] = MappingProxyType({"smpl22": JOINT_MAPS["humanml3d-22"], **JOINT_MAPS})

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of everything in ``recording.toml``."""


class Units(_Part, frozen=True, kw_only=True):
    """Units of all lengths and of all times in the tables."""

    length: Literal["m", "cm", "mm"]
    time: Literal["s", "ms", "us", "ns"]


class Axes(_Part, frozen=True, kw_only=True):
    """The world of the tables.

    Attributes:
        up: Axis that points up.
        quaternion: Order in which the columns ``qw``, ``qx``, ``qy`` and ``qz`` stand in each table.
        handed: Handedness of the axes; ``left`` in Unity and Unreal.
    """

    up: Axis
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    handed: Literal["right", "left"] = "right"


class HeadAxes(_Part, frozen=True, kw_only=True):
    """The axes of the head's pose that point where the face does, and up."""

    forward: Axis = "z"
    up: Axis = "y"

    def __post_init__(self) -> None:
        if self.forward[-1] == self.up[-1]:
            raise ValueError(f"forward '{self.forward}' and up '{self.up}' stand at no right angle")


class GazeFrame(_Part, frozen=True, kw_only=True):
    """The frame of gaze: the world, or the axes of the head's pose."""

    frame: Literal["world", "head"] = "world"


class Video(_Part, frozen=True, kw_only=True):
    """Time of frame 0 on the clock of the tables, in their unit, and frames a second."""

    start: float = 0.0
    fps: Annotated[float, msgspec.Meta(gt=0)]


class Body(_Part, frozen=True, kw_only=True):
    """Name of the body's skeleton, and what measured or estimated it."""

    skeleton: str = "smpl22"
    source: Annotated[str, msgspec.Meta(pattern="^[a-z0-9-]*$")] = ""  # becomes a part of the names of sequences

    def __post_init__(self) -> None:
        if self.skeleton not in SKELETONS:
            near = did_you_mean(self.skeleton, SKELETONS)
            raise ValueError(f"no skeleton '{self.skeleton}'.{near} Known ones: {', '.join(SKELETONS)}")


class About(_Part, frozen=True, kw_only=True):
    """The content of ``recording.toml``, and what it says of our world: metres, Y up, right-handed, seconds.

    A left-handed world is mirrored, and so are the axes of each rigid body in it, by their x.

    Attributes:
        participant: Name of the person.
        video: None where events have times and no frames.
    """

    version: Literal[1] = 1
    participant: Annotated[str, msgspec.Meta(min_length=1)]
    units: Units
    axes: Axes
    head: HeadAxes = HeadAxes()
    gaze: GazeFrame = GazeFrame()
    video: Video | None = None
    body: Body = Body()

    @property
    def metres(self) -> float:
        """Metres a unit of length."""
        return LENGTH_UNITS[self.units.length]

    @property
    def seconds(self) -> float:
        """Seconds a unit of time."""
        return TIME_UNITS[self.units.time]

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """Our axes from the stated ones: a rotation, of a left-handed world with a reflection."""
        return to_y_up(np.eye(3), up=self.axes.up, left_handed=self.axes.handed == "left").T

    @property
    def mirror(self) -> Float[np.ndarray, "3 3"]:
        """A rigid body's axes from the stated ones."""
        return np.diag([-1.0 if self.axes.handed == "left" else 1.0, 1.0, 1.0])

    @property
    def head_from_cpf(self) -> Float[np.ndarray, "3 3"]:
        """Axes of the head's pose from left, up and forward of the face."""
        stated = dict(zip(("x", "y", "z", "-x", "-y", "-z"), [*self.mirror, *-self.mirror], strict=True))
        up, forward = stated[self.head.up], stated[self.head.forward]
        return np.column_stack([np.cross(up, forward), up, forward])

    def points(self, positions: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
        """Return positions in our world, metres."""
        return positions @ self.turn.T * self.metres


POINT = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
BOX = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
# Columns of text; all others hold numbers.
TEXTS = frozenset({"side", "object_id", "name", "category", "movable", "action", "object", "hand"})


GAZE = ("dx", "dy", "dz")
ORIGIN = ("ox", "oy", "oz")
# Forms of texts; empty ones state nothing. Ids become parts of names that slashes separate.
WORDS = MappingProxyType({"side": "left|right", "movable": "true|false|yes|no|1|0|", "object_id": "[^/]*[^/ ][^/]*"})

# Columns of each table: those that it must have, and groups that are there together or not at all. The body's are
# named after the joints of its skeleton: ``<joint>_x``.
TABLES: Mapping[str, tuple[tuple[str, ...], ...]] = MappingProxyType(
    {
        "head": (("time", *POINT, *QUATERNION),),
        "gaze": (("time", *GAZE), ORIGIN),
        "wrists": (("time", "side", *POINT), QUATERNION),
        "body": (("time",),),
        "objects": (("object_id", "name"), ("category",), ("movable",), BOX),
        "object_poses": (("time", "object_id", *POINT), QUATERNION),
        "events": (("action", "object"), ("time",), ("frame",), POINT, BOX, ("hand",)),
    }
)


def body_columns(about: About) -> tuple[str, ...]:
    """Return the columns of the joints of a recording's skeleton, in the order of its arrays."""
    return tuple(f"{joint}_{axis}" for joint in SKELETONS[about.body.skeleton].source_joints for axis in POINT)


def columns_of(table: str, about: About) -> tuple[tuple[str, ...], ...]:
    """Return the columns of one table of a recording, grouped as in :data:`TABLES`."""
    return TABLES[table] if table != "body" else (("time", *body_columns(about)),)
