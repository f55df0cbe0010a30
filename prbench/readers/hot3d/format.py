"""HOT3D: file names, columns, and the content of one Aria recording (docs/specification/hot3d.md).

Native world: metres, Z up, gravity (0, 0, -9.81); the same as that of the recording's MPS files. Ground truth has a
clock of its own (TIME_CODE, integer nanoseconds), MPS the glasses' device clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.readers.aria_mps.format import MpsReadings
from prbench.readers.egoallo.format import EgoAlloBody, EgoAlloOutput
from prbench.recording import Side, UnreadableEntry

METADATA_FILE = "metadata.json"
OBJECTS_FILE = "dynamic_objects.csv"
HEADSET_FILE = "headset_trajectory.csv"
UMETRACK_FILE = "umetrack_hand_pose_trajectory.jsonl"
PROFILE_FILE = "umetrack_hand_user_profile.json"
MASK_FOLDER = "masks"
MPS_FOLDER = "mps"
INSTANCES_FILE = "instance.json"
LIBRARY_FOLDERS = ("assets", "object_library")  # Folders of the object models, beside the recordings or one level up.
ARIA = "Aria"
LIBRARY_OBJECT = "object"  # ``instance_type`` of what can be held; the headsets are listed too.

STREAM = "stream_id"
MASK = "mask"
RGB_STREAM = "214-1"
SLAM_STREAMS = ("1201-1", "1201-2")
HAND_KEYS: dict[Side, str] = {"left": "0", "right": "1"}

MaskName = Literal["qa_pass", "headset_pose_available", "object_pose_available", "hand_pose_available"]
# Masks that curation honours; their files are ``masks/mask_<name>.csv``.
MASK_NAMES: tuple[MaskName, ...] = ("qa_pass", "headset_pose_available", "object_pose_available", "hand_pose_available")

_PAIR_NS = 1_000_000  # Rows closer than this belong to one instant: RGB and SLAM cameras are 91 us apart.


def first_of_pairs(time_ns: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return True for rows that are a millisecond or more after the row before: one of RGB and SLAM camera."""
    return np.diff(time_ns, prepend=time_ns[:1] - _PAIR_NS) >= _PAIR_NS


@dataclass(frozen=True)
class PoseRows:
    """One body of ``dynamic_objects.csv`` or ``headset_trajectory.csv``: its frame to the world.

    Attributes:
        rotation: w x y z.
    """

    time_ns: Int[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]


# Vertices (metres) and faces of a ``.glb`` model in the object's frame, node transforms applied.
Mesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]
Mask = tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]  # Times (ns) of the RGB stream, and where they are good.


@dataclass(frozen=True)
class Hot3dObject:
    """One object of a recording.

    Attributes:
        object_id: Up to 15 digits.
        mesh: None where its model is missing.
    """

    object_id: str
    name: str
    rows: PoseRows
    mesh: Mesh | None


@dataclass(frozen=True)
class HandRows:
    """One hand over time, by UmeTrack: rows where it is tracked.

    Attributes:
        position: Position of the wrist, metres, world.
        rotation: w x y z, hand to world.
        angles: 22 joint angles, radians.
    """

    side: Side
    time_ns: Int[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    angles: Float[np.ndarray, "n 22"]


@dataclass(frozen=True)
class HandModel:
    """One user's left hand, at rest, in the frame of its wrist.

    Attributes:
        weights: Share of each bone in each vertex; rows sum to 1.
        landmarks: Finger tips thumb to little, wrist, two of the thumb, three a finger, palm; not read, only written.
        landmark_weights: Share of each bone in each landmark; not read, only written.
        triangles: Triangles of the vertices; not read, only written.
    """

    vertices: Float[np.ndarray, "v 3"]
    weights: Float[np.ndarray, "v 17"]
    joint_positions: Float[np.ndarray, "22 3"]
    joint_axes: Float[np.ndarray, "22 3"]
    landmarks: Float[np.ndarray, "21 3"] | None = None
    landmark_weights: Float[np.ndarray, "21 17"] | None = None
    triangles: Int[np.ndarray, "f 3"] | None = None


@dataclass(frozen=True)
class Hot3dReadings:
    """Readings of one HOT3D recording's sensors: the content of its files, before or after the text.

    Attributes:
        headset: Device to world, on the clock of the ground truth; the MPS trajectory at the nearest millisecond.
        hands: UmeTrack.
        hand_model: None where the profile is missing: then there are wrists, but no vertices.
        masks: Those that the recording has.
        mps: Content of the MPS files; the whole trajectory tells the clocks' offset.
        body: EgoAllo's body on the device clock; None without outputs.
        egoallo_outputs: Not read, only written: what ``body`` was computed from.
        messages: Messages of reading the files.
        unreadable: Entries of the annotation files that cannot be read.
    """

    recording_id: str
    participant_id: str
    headset: PoseRows
    objects: tuple[Hot3dObject, ...]
    hands: tuple[HandRows, ...]
    hand_model: HandModel | None
    masks: dict[MaskName, Mask]
    mps: MpsReadings
    body: EgoAlloBody | None
    egoallo_outputs: tuple[EgoAlloOutput, ...] = ()
    messages: tuple[str, ...] = ()
    unreadable: tuple[UnreadableEntry, ...] = ()
