"""A GIMO folder of some dozen frames: a standing body that glides along a curve, written by the synthetic layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import PARENTS
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.bvh import POSITION_CHANNELS, BvhJoint, BvhMotion
from prbench.readers.gimo.files import GimoOptions, find_segments, read_readings
from prbench.readers.gimo.synthetic import (
    DEPTH_FIRST,
    LAYOUT,
    SKELETON_NAMES,
    write_events,
    write_sequence,
    write_table,
)
from tests.fakes import STANDING

N_FRAMES = 45
LEAD = 30  # frames of the suit before the segment, at 60 Hz
EULER = ("Zrotation", "Xrotation", "Yrotation")


def path_of_pelvis(seconds: np.ndarray) -> np.ndarray:
    """Where the pelvis is, suit frame: a curve that fits itself at no other time."""
    return np.column_stack([0.4 * seconds**2, 0.95 + 0.02 * np.sin(5 * seconds), 0.3 * np.sin(2 * seconds)])


def skeleton(n_frames: int = N_FRAMES, *, unit: float = 100.0) -> BvhMotion:
    """The suit's file of the gliding body, ``unit`` file units a metre."""
    joints = []
    for joint in DEPTH_FIRST:
        parent = PARENTS[joint]
        x, y, z = np.round((STANDING[joint] - STANDING[max(parent, 0)]) * unit, 6).tolist()
        channels = (*POSITION_CHANNELS, *EULER) if parent < 0 else EULER
        joints.append(
            BvhJoint(SKELETON_NAMES[joint], -1 if parent < 0 else DEPTH_FIRST.index(parent), (x, y, z), channels)
        )
    seconds = (np.arange(LEAD + 2 * n_frames) - LEAD) / 60
    values = np.zeros((len(seconds), 3 + 3 * len(joints)))
    values[:, :3] = np.round(path_of_pelvis(seconds) * unit, 6)
    return BvhMotion(tuple(joints), 1 / 60, values)


def readings(start: int = 100, *, scene: str = "room1", sequence: str = "2022-01-23-080759") -> gimo.GimoReadings:
    """A sound segment: scale 1.25, a turned scan, gaze on all frames, one pick on its last frame but five."""
    segment = gimo.Segment(
        scene, sequence, start, start + N_FRAMES - 1, "transform_info_0.json", gimo.TRAIN, "take book"
    )
    pelvis = path_of_pelvis(np.arange(N_FRAMES) / 30)
    poses = gimo.SmplxPoses(
        frames=segment.frames,
        orient=np.zeros((N_FRAMES, 3), dtype=np.float32),
        trans=(pelvis - np.array(gimo.REST_PELVIS)).astype(np.float32),
        latent=np.zeros((N_FRAMES, gimo.N_LATENT), dtype=np.float32),
    )
    points = np.tile([1.0, 2.0, 3.0], (N_FRAMES, 1)) + 0.01 * np.arange(N_FRAMES)[:, None]
    return gimo.GimoReadings(
        recording_id=segment.name,
        segment=segment,
        transform=gimo.SceneTransform(
            1.25, rigid((0.3, 0.2, -0.1), (1.0, 2.0, 3.0)), rigid((-0.2, 0.5, 0.1), (0.5, 0.0, -1.0))
        ),
        body=gimo.LocalSkeleton(skeleton(), poses),
        gaze=gimo.GazePoints(segment.frames, points),
        events=(gimo.EventFrame(segment.end_frame - 5, "right"),),
    )


def rigid(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> np.ndarray:
    """A transform from a rotation vector and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    matrix[:3, 3] = shift
    return matrix


def write_root(root: Path, *segments: gimo.GimoReadings, table: Sequence[gimo.Segment] | None = None) -> Path:
    """A dataset folder of some segments, with their table (another one, if given) and their events."""
    for each in segments:
        folder = root / each.segment.scene / each.segment.sequence
        write_sequence(each, folder)
        norm = folder.parent / gimo.SCENE_FOLDER / gimo.NORM_FILE
        norm.parent.mkdir(exist_ok=True)
        norm.write_text("\n".join(" ".join(map(repr, row)) for row in each.transform.room_from_scene.tolist()) + "\n")
    write_table(root / gimo.TABLE_FILE, table or [each.segment for each in segments])
    write_events(root / gimo.EVENTS_FILE, [(each.segment, event) for each in segments for event in each.events])
    return root


def read_back(root: Path, **options: object) -> gimo.GimoReadings:
    """The readings of the first segment below a root."""
    chosen = GimoOptions(**options)  # type: ignore[arg-type]
    return read_readings(find_segments(root, chosen)[0], chosen)


def recording(of: gimo.GimoReadings):
    """The recording in memory."""
    return replace(LAYOUT.recording(of), dataset="gimo")
