"""Aria Digital Twin: file names, columns, the 51 joints, and the content of one recording.

Source: docs/specification/adt.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.readers.aria_mps.format import AriaTrajectory, GazeAngles, GlassesSize
from prbench.readers.egoallo.format import EgoAlloBody
from prbench.recording import UnreadableEntry

METADATA_FILE = "metadata.json"
INSTANCES_FILE = "instances.json"
OBJECTS_FILE = "scene_objects.csv"
BOXES_FILE = "3d_bounding_box.csv"
TRAJECTORY_FILE = "aria_trajectory.csv"
GAZE_FILE = "eyegaze.csv"
ASSOCIATION_FILE = "skeleton_aria_association.json"
MPS_FOLDER = "mps"

TIME_DOMAIN = "DEVICE_CAPTURE"
NOBODY = "NONE"  # Stands for a missing serial or skeleton in the association file.

BOX_MIN = ("p_local_obj_xmin[m]", "p_local_obj_ymin[m]", "p_local_obj_zmin[m]")
BOX_MAX = ("p_local_obj_xmax[m]", "p_local_obj_ymax[m]", "p_local_obj_zmax[m]")
STATIC_TIME = -1  # Time of an object that never moves.

# Object rows stand 700 ns after the glasses' row of the same instant (rounding of the release).
OBJECT_AFTER_POSE_NS = 700
GAZE_BEFORE_POSE_US = 3
# Seconds; rows closer than this are of one instant, which the files write with different rounding.
SAME_INSTANT = 0.002

SCENE_BOX_ID = 4377907428960199  # ``ApartmentEnv``, whose box encloses the room.
ROOM_SIZE = 3.0  # Metres; a box with a longer side that holds the wearer's eyes encloses the room.

LONGEST_BODY_STEP = 0.02  # Seconds; the suit runs at 120 Hz, a longer step is a gap.
UP = (0.0, 1.0, 0.0)
# The scene turned so that Z is up, (x, y, z) to (x, -z, y): the world in which EgoAllo must see it.
Z_UP_FROM_SCENE = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])

# Order of the 51 joints; the files hold no names. A position is the proximal end of the named bone.
JOINT_NAMES: tuple[str, ...] = (
    "Skeleton", "Ab", "Chest", "Neck", "Head",
    "LShoulder", "LUArm", "LFArm", "LHand",
    "LThumb1", "LThumb2", "LThumb3", "LIndex1", "LIndex2", "LIndex3", "LMiddle1", "LMiddle2", "LMiddle3",
    "LRing1", "LRing2", "LRing3", "LPinky1", "LPinky2", "LPinky3",
    "RShoulder", "RUArm", "RFArm", "RHand",
    "RThumb1", "RThumb2", "RThumb3", "RIndex1", "RIndex2", "RIndex3", "RMiddle1", "RMiddle2", "RMiddle3",
    "RRing1", "RRing2", "RRing3", "RPinky1", "RPinky2", "RPinky3",
    "LThigh", "LShin", "LFoot", "LToe", "RThigh", "RShin", "RFoot", "RToe",
)  # fmt: skip
N_NATIVE_JOINTS = len(JOINT_NAMES)
N_MARKERS = 57

WRIST_JOINTS = (JOINT_NAMES.index("LHand"), JOINT_NAMES.index("RHand"))
MIDDLE_FINGER_BASES = (JOINT_NAMES.index("LMiddle1"), JOINT_NAMES.index("RMiddle1"))

_HINGED_CATEGORIES = frozenset({"door", "drawer", "part of a cabinet/wardrobe"})
_HINGED_WORDS = ("Door", "Drawer")


def is_hinged(name: str, category: str) -> bool:
    """Return True for a door, a drawer or another part of furniture that turns or slides in its place.

    The files hold no joints of furniture, so category and name decide: categories ``door``, ``drawer`` and
    ``part of a cabinet/wardrobe``, and names that contain ``Door`` or ``Drawer``.
    """
    return category in _HINGED_CATEGORIES or any(word in name for word in _HINGED_WORDS)


def body_joints(joints: Float[np.ndarray, "n 51 3"], mapping: Sequence[str]) -> Float[np.ndarray, "n 22 3"]:
    """Return the 22 joints from the 51 native ones.

    Args:
        joints: Native joints, metres.
        mapping: Native name of each of the 22 joints; ``a+b`` is the mean of two.
    """
    named = [entry.split("+") for entry in mapping]
    first = [JOINT_NAMES.index(names[0]) for names in named]
    return (joints[:, first] + joints[:, [JOINT_NAMES.index(names[-1]) for names in named]]) / 2


@dataclass(frozen=True)
class AdtObject:
    """One entry of ``instances.json`` with its box and its rows of ``scene_objects.csv``.

    Attributes:
        time_ns: Device time; one row of -1 for an object that never moves.
        rotation: w x y z, object to scene.
    """

    object_id: int
    name: str
    prototype: str
    category: str
    dynamic: bool
    box_min: Float[np.ndarray, "3"]
    box_max: Float[np.ndarray, "3"]
    time_ns: Int[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]


@dataclass(frozen=True)
class AdtSkeleton:
    """One tracked person: ``Skeleton_<X>.json`` and its entry in the association file.

    Attributes:
        serial: Serial of the glasses that the person wears; ``NONE`` without glasses.
        markers: Not read, only written: nothing is computed from them.
    """

    name: str
    skeleton_id: int
    serial: str
    time_ns: Int[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 51 3"]
    markers: Float[np.ndarray, "n 57 3"] | None = None


@dataclass(frozen=True)
class AdtReadings:
    """Readings of one ADT recording's sensors: the content of its files, before or after the text.

    Scene frame: metres, Y up. Times: the glasses' device clock, in integers as the files hold them.

    Attributes:
        concurrent: Id of the recording that the other wearer made at the same time; empty where there is none.
        glasses_size: None where no file tells.
        device_from_rgb: Calibrated pose of the RGB camera; None where no file tells.
        glasses: ``aria_trajectory.csv``.
        estimated_body: EgoAllo's estimate, in the scene turned to Z up (:data:`Z_UP_FROM_SCENE`); None where there is
            none or none was asked for.
        messages: Messages of reading the files.
        unreadable: Entries of the annotation files that cannot be read.
    """

    recording_id: str
    serial: str
    concurrent: str
    glasses_size: GlassesSize | None
    device_from_rgb: Float[np.ndarray, "4 4"] | None
    glasses: AriaTrajectory
    gaze: GazeAngles
    objects: tuple[AdtObject, ...]
    skeletons: tuple[AdtSkeleton, ...]
    estimated_body: EgoAlloBody | None = None
    messages: tuple[str, ...] = ()
    unreadable: tuple[UnreadableEntry, ...] = ()
