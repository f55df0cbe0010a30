"""MoGaze: file names, keys, coordinate frames, and the content of one recording (docs/specification/mogaze.md)."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

RATE = 120.0
"""Frames a second; all streams of a recording share one frame index, and frame 0 is time 0."""

PARTS = ("human_data", "object_data", "gaze_data", "segmentations")
"""The four files of a recording are named ``<recording>_<part>.hdf5``."""
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
PARTICIPANT_ATTRIBUTE = "participant"
"""Written by prbench only: real recordings carry the participant in their name."""
GAZE_POINT = slice(2, 5)
FEWEST_GAZE_COLUMNS = 6
LABEL_LENGTH = 32

NULL_LABEL = "null"
GOGGLES = "goggles"
BODIES_WITHOUT_SCENE: tuple[str, ...] = (
    "table", "cup_red", "laiva_shelf", "vesken_shelf", "plate_blue", "jug", "goggles", "plate_green",
    "plate_red", "cup_green", "cup_blue", "red_chair", "cup_pink", "plate_pink", "bowl", "blue_chair",
)  # fmt: skip
"""Names of the 16 bodies in the order in which HDF5 lists their keys; for copies that lack ``scene.xml``."""
FURNITURE = ("table", "shelf", "chair")
"""Kinds of bodies that are tracked, but neither picked up nor put down."""

LONGEST_LENGTH_DIFFERENCE = 0.01
"""Share of the longest stream by which the streams of a recording may differ; more is another recording's file."""
UNREMARKABLE_LENGTH_DIFFERENCE = 2
"""Frames."""


def kind_of_body(name: str) -> str:
    """Kind of a body: ``cup``, ``plate``, ``jug``, ``bowl``, ``table``, ``laiva_shelf``, ``red_chair`` → ``chair``.

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
    goggles_position: Float[np.ndarray, "n 3"],
    goggles_rotation: Float[np.ndarray, "n 3 3"],
    calibration: Float[np.ndarray, "3 3"],
    points: Float[np.ndarray, "n 3"],
    *,
    legacy: bool = False,
) -> Float[np.ndarray, "n 3"]:
    """Unit gaze directions in the dataset's world (docs/specification/mogaze.md#head-pose-and-gaze-ray).

    Args:
        goggles_position: Metres.
        goggles_rotation: Goggles to world.
        calibration: Eye tracker's camera to goggles.
        points: Gaze points in the camera's frame, millimetres; one behind it (z < 0) is mirrored first.
        legacy: Subtract the goggles' position once more, as the dataset's own player does: 0.05 to 0.5 degrees off.

    Returns:
        NaN where an input is NaN or the point is the origin.
    """
    ahead = np.where(points[:, 2:] < 0, -points, points)
    turned = (goggles_rotation @ calibration @ ahead[:, :, None])[:, :, 0]
    aimed = turned - goggles_position if legacy else turned
    length = np.linalg.norm(aimed, axis=1, keepdims=True)
    return np.divide(aimed, length, out=np.full_like(aimed, np.nan), where=length > 0)


@dataclass(frozen=True)
class MogazeBody:
    """One tracked rigid body: its rows of ``object_data`` and what ``scene.xml`` knows of it."""

    body_id: int
    name: str
    position: Float[np.ndarray, "n 3"]
    """Metres, Z up; NaN where the body was not seen."""
    rotation: Float[np.ndarray, "n 4"]
    """x y z w, body to world; zeros or NaN where the body was not seen."""
    box_min: Float[np.ndarray, "3"]
    box_max: Float[np.ndarray, "3"]
    vertices: Float[np.ndarray, "v 3"] | None = None
    """Vertices of its mesh, in its own frame; None without a mesh, or where nobody asked for it."""
    faces: Int[np.ndarray, "f 3"] | None = None


@dataclass(frozen=True)
class Segment:
    """One entry of ``segmentations``: from ``start`` to ``end`` this object moves, or nothing does."""

    start: int
    end: int
    """Inclusive; the next segment starts with this frame or the one after it."""
    label: str


@dataclass(frozen=True)
class MogazeReadings:
    """The content of the files of one MoGaze recording, in the units and frames of the files; equal lengths."""

    recording_id: str
    participant_id: str
    state: Float[np.ndarray, "n 66"]
    """Columns in the order of :data:`prbench.readers.mogaze.body.STATE_COLUMNS`, metres and radians."""
    fixed: dict[str, float]
    """Scaling values by key."""
    bodies: tuple[MogazeBody, ...]
    """Sorted by id."""
    gaze_points: Float[np.ndarray, "n 3"]
    gaze_confidence: Float[np.ndarray, " n"]
    calibration: Float[np.ndarray, "4"]
    """x y z w."""
    segments: tuple[Segment, ...]
    """In the order of the file."""
    messages: tuple[str, ...] = ()
    """Messages of reading the files."""
