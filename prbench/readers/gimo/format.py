"""GIMO: file names, constants, and the content of one segment (docs/specification/gimo.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from prbench.readers.gimo.bvh import BvhMotion
from prbench.recording import Side, UnreadableEntry

TABLE_FILE = "dataset.csv"
EVENTS_FILE = "prbench_events.csv"  # The user's own annotations, at the root unless a reader option names another file.
SCENE_FOLDER = "scene_obj"
POSE_FOLDER = "smplx_local"
GAZE_FOLDER = "eye_pc"
NORM_FILE = "transform_norm.txt"
SKELETON_FILE = "skeleton.bvh"
GAZE_CENTRE_SUFFIX = "_center"

TABLE_COLUMNS = ("sequence_path", "start_frame", "end_frame", "scene", "transformation", "training")
ACTIVITY_COLUMN = "action"
HINT_INDEX = 7  # Index of the unnamed column that holds a frame inside the segment on some rows: evidently the contact.
EVENT_COLUMNS = ("scene", "sequence_path", "start_frame", "end_frame", "event_frame", "action", "hand")
CONFIRMED_COLUMN = "confirmed"
# Columns of a table of proposed events.
CANDIDATE_COLUMNS = (*EVENT_COLUMNS, CONFIRMED_COLUMN, "confidence", "reason", "activity")
# Values of the column ``training``; the official loader never uses 2.
TEST = 0
TRAIN = 1
TRAIN_LATER = 2
# Names of these values in a study of motion prediction.
PUBLISHED_SPLITS = {TRAIN: "train", TEST: "test", TRAIN_LATER: "unused"}
GIMO23 = "gimo23"  # That study's joint set: the 22 joints and the jaw.

FRAME_RATE = 30.0
REST_PELVIS = (0.0031, -0.3514, 0.0120)  # J0: the pelvis of SMPL-X neutral in its rest pose, metres.
N_LATENT = 32
NO_POINT = 1e-8  # A gaze point whose coordinates sum to less is none.
OBJECT_ID = "target"  # The dataset knows no objects; every event has this one.


@dataclass(frozen=True)
class Segment:
    """One row of ``dataset.csv``.

    Attributes:
        activity: Activity of the person, in the fuller copies of the table (``take book``).
        hint: Frame of the unnamed column, where it lies inside the segment.
    """

    scene: str
    sequence: str
    start_frame: int
    end_frame: int
    transformation: str
    training: int
    activity: str = ""
    hint: int | None = None

    @property
    def key(self) -> tuple[str, str, int, int]:
        """Return the values that identify the row."""
        return self.scene, self.sequence, self.start_frame, self.end_frame

    @property
    def name(self) -> str:
        """Return the recording id: scene, sequence and frames, without characters that file names forbid."""
        return f"{self.group}_{self.start_frame}-{self.end_frame}"

    @property
    def group(self) -> str:
        """Return the scene and sequence: what segments of one recording have in common."""
        return f"{_plain(self.scene)}_{_plain(self.sequence)}"

    @property
    def frames(self) -> Int[np.ndarray, " n"]:
        """Return all frame numbers, both ends included."""
        return np.arange(self.start_frame, self.end_frame + 1)


def _plain(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-._" else "-" for letter in name)


@dataclass(frozen=True)
class EventFrame:
    """One pick that somebody annotated."""

    frame: int
    hand: Side | None = None
    source: Literal["annotated", "hint"] = "annotated"


@dataclass(frozen=True)
class SceneTransform:
    """Transforms between body and scan; matrices as the files hold them, translations in scan units."""

    scale: float
    scene_from_body: Float[np.ndarray, "4 4"]
    room_from_scene: Float[np.ndarray, "4 4"]

    def room_from_body(self) -> Float[np.ndarray, "4 4"]:
        """Return the rigid transform from the suit's own frame to the canonical room, metres of the body."""
        return self._metric(self.room_from_scene) @ self._metric(self.scene_from_body)

    def room_from_scan(self) -> Float[np.ndarray, "4 4"]:
        """Return the transform from scan coordinates to the canonical room; it shrinks by the scale."""
        return self._metric(self.room_from_scene) @ np.diag([1 / self.scale, 1 / self.scale, 1 / self.scale, 1.0])

    def _metric(self, transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        metric = transform.copy()
        metric[:3, 3] /= self.scale
        return metric


@dataclass(frozen=True)
class SmplxPoses:
    """``smplx_local``: one row a frame that has a file. Suit frame: metres, Y up.

    Attributes:
        orient: Axis-angle of the root.
        trans: ``transl`` of SMPL-X: the pelvis is at this plus :data:`REST_PELVIS`.
        latent: VPoser v1 code of the 21 body joints.
    """

    frames: Int[np.ndarray, " n"]
    orient: Float[np.ndarray, "n 3"]
    trans: Float[np.ndarray, "n 3"]
    latent: Float[np.ndarray, "n 32"]

    def pelvis(self) -> Float[np.ndarray, "n 3"]:
        """Return the pelvis joint without any body model, suit frame, metres."""
        return self.trans.astype(np.float64) + np.array(REST_PELVIS)


@dataclass(frozen=True)
class LocalJoints:
    """The 22 joints, as the body model gives them.

    Attributes:
        joints: Suit frame, metres.
        jaw: Joint 22 of SMPL-X, suit frame, metres; None where the model's file does not tell it.
    """

    frames: Int[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    jaw: Float[np.ndarray, "n 3"] | None = None


@dataclass(frozen=True)
class LocalSkeleton:
    """The suit's own skeleton, which lies along the pelvis track of the fitted body."""

    motion: BvhMotion
    poses: SmplxPoses


@dataclass(frozen=True)
class GazePoints:
    """``eye_pc``: where the gaze meets the scan, on the frames that have one.

    Attributes:
        points: Scan coordinates.
    """

    frames: Int[np.ndarray, " m"]
    points: Float[np.ndarray, "m 3"]


@dataclass(frozen=True)
class GimoReadings:
    """Readings of one segment: the content of its files.

    Attributes:
        messages: Messages of reading the files.
        unreadable: Entries of the annotation files that cannot be read.
    """

    recording_id: str
    segment: Segment
    transform: SceneTransform
    body: LocalJoints | LocalSkeleton
    gaze: GazePoints
    events: tuple[EventFrame, ...]
    messages: tuple[str, ...] = ()
    unreadable: tuple[UnreadableEntry, ...] = ()
