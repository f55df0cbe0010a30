"""MoGaze: file names, keys, coordinate frames, and the content of one recording (docs/specification/mogaze.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import forward_kinematics
from prbench.recording import UnreadableEntry

RATE = 120.0  # Frames a second; all streams of a recording share one frame index, and frame 0 is time 0.

# The four files of a recording are named ``<recording>_<part>.hdf5``.
PARTS = ("human_data", "object_data", "gaze_data", "segmentations")
SCENE_FILE = "scene.xml"
MESH_FOLDER = "meshfiles"

HUMAN_DATASET = "data"
OBJECT_GROUP = "bodies"
GAZE_DATASET = "gaze"
SEGMENT_DATASET = "segments"
COLUMNS_ATTRIBUTE = "description"
START_ATTRIBUTE = "startframe"
FIXED_KEYS_ATTRIBUTE = "keys_fixed"
FIXED_VALUES_ATTRIBUTE = "values_fixed"
CALIBRATION_ATTRIBUTE = "calibration"
LABELS_ATTRIBUTE = "labels"
PARTICIPANT_ATTRIBUTE = "participant"  # Written by prbench only: real recordings carry the participant in their name.
GAZE_POINT = slice(2, 5)
FEWEST_GAZE_COLUMNS = 6
LABEL_LENGTH = 32

NULL_LABEL = "null"
GOGGLES = "goggles"
FURNITURE = ("table", "shelf", "chair")  # Kinds of bodies that are tracked, but neither picked up nor put down.

# Share of the longest stream by which the streams of a recording may differ; more is another recording's file.
LONGEST_LENGTH_DIFFERENCE = 0.01
UNREMARKABLE_LENGTH_DIFFERENCE = 2  # Frames.


def kind_of_body(name: str) -> str:
    """Return the kind of a body: ``cup_red`` → ``cup``, ``laiva_shelf`` → ``laiva_shelf``, ``red_chair`` → ``chair``.

    Colours and numbers are left out; a name that follows no known pattern is its own kind.
    """
    name = re.sub(r"_\d+$", "", name)
    if name.startswith(("cup_", "plate_")):
        return name.split("_")[0]
    return "chair" if name.endswith("_chair") else name


def is_furniture(name: str) -> bool:
    """Return True where a body stands in its place for the whole recording."""
    return kind_of_body(name).lower().endswith(FURNITURE)


def gaze_directions(
    goggles: Float[np.ndarray, "n 3 3"], calibration: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return the unit gaze directions in the dataset's world (docs/specification/mogaze.md#head-pose-and-gaze-ray).

    Args:
        goggles: Rotations, goggles to world.
        calibration: Eye tracker's camera to goggles.
        points: Gaze points in the camera's frame, any unit; one behind it (z < 0) is mirrored first.

    Returns:
        NaN where an input is NaN or the point is the origin.
    """
    aimed = (goggles @ calibration @ np.where(points[:, 2:] < 0, -points, points)[:, :, None])[:, :, 0]
    length = np.linalg.norm(aimed, axis=1, keepdims=True)
    return np.divide(aimed, length, out=np.full_like(aimed, np.nan), where=length > 0)


@dataclass(frozen=True)
class MogazeBody:
    """One tracked rigid body: its rows of ``object_data`` and what ``scene.xml`` knows of it.

    Attributes:
        position: Metres, Z up; NaN where the body was not seen.
        rotation: x y z w, body to world; zeros or NaN where the body was not seen.
    """

    body_id: int
    name: str
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    box_min: Float[np.ndarray, "3"]
    box_max: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class Segment:
    """One entry of ``segmentations``: from ``start`` to ``end`` this object moves, or nothing does.

    Attributes:
        end: Inclusive; the next segment starts with this frame or the one after it.
    """

    start: int
    end: int
    label: str


@dataclass(frozen=True)
class MogazeReadings:
    """The content of the files of one MoGaze recording, in the units and frames of the files; equal lengths.

    Attributes:
        state: Columns in the order of :data:`prbench.readers.mogaze.format.STATE_COLUMNS`, metres and radians.
        fixed: Scaling values by key.
        bodies: Sorted by id.
        calibration: x y z w.
        segments: Segments in the order of the file.
        messages: Messages of reading the files.
        unreadable: Entries of the annotation files that cannot be read.
    """

    recording_id: str
    participant_id: str
    state: Float[np.ndarray, "n 66"]
    fixed: dict[str, float]
    bodies: tuple[MogazeBody, ...]
    gaze_points: Float[np.ndarray, "n 3"]
    gaze_confidence: Float[np.ndarray, " n"]
    calibration: Float[np.ndarray, "4"]
    segments: tuple[Segment, ...]
    messages: tuple[str, ...] = ()
    unreadable: tuple[UnreadableEntry, ...] = ()


# The 21 joints in the order of the files, each with the joint that it hangs on; parents come first.
PARENT_LINKS: dict[str, str] = {
    "base": "", "pelvis": "base", "torso": "pelvis", "neck": "torso", "head": "neck",
    "linnerShoulder": "torso", "lShoulder": "linnerShoulder", "lElbow": "lShoulder", "lWrist": "lElbow",
    "rinnerShoulder": "torso", "rShoulder": "rinnerShoulder", "rElbow": "rShoulder", "rWrist": "rElbow",
    "lHip": "base", "lKnee": "lHip", "lAnkle": "lKnee", "lToe": "lAnkle",
    "rHip": "base", "rKnee": "rHip", "rAnkle": "rKnee", "rToe": "rAnkle",
}  # fmt: skip
LINKS: tuple[str, ...] = tuple(PARENT_LINKS)
_N_LINKS = len(LINKS)

# The 66 columns of a joint state in their usual order; files are read by name. Metres and radians.
STATE_COLUMNS: tuple[str, ...] = (
    *(f"baseTrans{axis}" for axis in "XYZ"),
    *(f"{link}Rot{axis}" for link in LINKS for axis in "XYZ"),
)
# The 60 fixed scaling values of a recording, metres.
OFFSET_KEYS: tuple[str, ...] = tuple(f"{link}Trans{axis}" for link in LINKS[1:] for axis in "XYZ")

_TRANSLATION_AXES: dict[str, str] = {
    "pelvis": "Z", "torso": "XYZ", "neck": "Z", "head": "YZ", "innerShoulder": "XYZ", "Shoulder": "X", "Elbow": "X",
    "Wrist": "XYZ", "Hip": "X", "Knee": "Z", "Ankle": "XYZ", "Toe": "YZ",
}  # fmt: skip


# The fixed values for which the model has a joint; the player ignores the others (below 2e-8 m in p1_1).
MODEL_OFFSETS: frozenset[str] = frozenset(
    f"{link}Trans{axis}"
    for link in LINKS[1:]
    for axis in _TRANSLATION_AXES[link if link in _TRANSLATION_AXES else link[1:]]
)

# Columns: left, up and forward of the face in the frame of the head link.
HEAD_FROM_CPF = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def link_offsets(fixed: Mapping[str, float]) -> Float[np.ndarray, "21 3"]:
    """Return the constant offset of each link in its parent's frame, metres; zero for the base.

    Limits of the model are not applied: the data hold negative offsets where it allows [0, 1].

    Args:
        fixed: ``keys_fixed`` and ``values_fixed``; keys without a joint of the model are ignored.

    Raises:
        KeyError: naming a value that the model needs and ``fixed`` lacks.
    """
    offsets = np.zeros((_N_LINKS, 3))
    for index, link in enumerate(LINKS[1:], start=1):
        for axis, letter in enumerate("XYZ"):
            key = f"{link}Trans{letter}"
            if key in MODEL_OFFSETS:
                offsets[index, axis] = fixed[key]
    return offsets


def link_poses(
    state: Float[np.ndarray, "n 66"], offsets: Float[np.ndarray, "21 3"]
) -> tuple[Float[np.ndarray, "n 21 3"], Float[np.ndarray, "n 21 3 3"]]:
    """Return the positions (metres) and rotations of the 21 links in the dataset's world (Z up).

    Args:
        state: Columns as in :data:`STATE_COLUMNS`; rows with NaN give NaN.
        offsets: See :func:`link_offsets`.
    """
    local = intrinsic_xyz(state[:, 3:].reshape(-1, _N_LINKS, 3))
    parents = [-1, *(LINKS.index(PARENT_LINKS[link]) for link in LINKS[1:])]
    return forward_kinematics(offsets, state[:, :3], local, parents)


def intrinsic_xyz(angles: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the rotation matrices Rx(a) Ry(b) Rz(c), radians."""
    (cos_x, cos_y, cos_z), (sin_x, sin_y, sin_z) = (np.moveaxis(f(angles), -1, 0) for f in (np.cos, np.sin))
    matrix = np.empty((*angles.shape, 3))
    matrix[..., 0, 0] = cos_y * cos_z
    matrix[..., 0, 1] = -cos_y * sin_z
    matrix[..., 0, 2] = sin_y
    matrix[..., 1, 0] = sin_x * sin_y * cos_z + cos_x * sin_z
    matrix[..., 1, 1] = cos_x * cos_z - sin_x * sin_y * sin_z
    matrix[..., 1, 2] = -sin_x * cos_y
    matrix[..., 2, 0] = sin_x * sin_z - cos_x * sin_y * cos_z
    matrix[..., 2, 1] = cos_x * sin_y * sin_z + sin_x * cos_z
    matrix[..., 2, 2] = cos_x * cos_y
    return matrix


def body_joints(positions: Float[np.ndarray, "n 21 3"], mapping: Sequence[str]) -> Float[np.ndarray, "n 22 3"]:
    """Return the 22 joints from the 21 links.

    Args:
        positions: Positions of the links, metres.
        mapping: Source of each of the 22 joints: a link (``torso``), the mean of some (``pelvis+torso``), or a
            weighted sum (``0.63 pelvis + 0.37 torso``).
    """
    return np.einsum("jl,nlk->njk", np.stack([_weights(entry) for entry in mapping]), positions)


def _weights(entry: str) -> Float[np.ndarray, "21"]:
    terms = [term.split() for term in entry.split("+")]
    weights = np.zeros(_N_LINKS)
    for term in terms:
        weights[LINKS.index(term[-1])] += float(term[0]) if len(term) == 2 else 1 / len(terms)
    return weights
