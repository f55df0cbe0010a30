"""Aria Digital Twin as EgoAllo must see it: Z up, and at 1 kHz.

Sources: docs/specification/egoallo.md#time and docs/specification/egoallo.md#world-and-floor.

EgoAllo takes every ``int(rate // 30)``-th pose, which is none of them where the rate is a little below 30 Hz; and it
takes Z for up, so that bodies would lie on their sides.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.readers.adt import format as adt
from prbench.readers.adt.to_recording import ASSUMED_SIZE, glasses_stream
from prbench.readers.aria_mps.format import AriaTrajectory, GlassesSize, device_from_cpf
from prbench.readers.aria_mps.to_recording import part_poses
from prbench.readers.egoallo.inputs import POINT_FILES, EgoalloInputs, aria_inputs, require_trajectory
from prbench.readers.found import RecordingFiles
from prbench.recording.streams import PoseStream

_STEP_US = 1_000
_GRAPH_UID = "adt-scene-z-up"


def glasses_z_up(glasses: adt.GlassesPoses, size: GlassesSize | None) -> PoseStream:
    """The glasses' central pupil frame in the scene turned to Z up, device seconds: what EgoAllo's outputs refer to."""
    return part_poses(_device_z_up(glasses), device_from_cpf(size or ASSUMED_SIZE))


def adt_inputs(root: Path, found: RecordingFiles) -> EgoalloInputs:
    """Look for what EgoAllo needs of a recording.

    Raises:
        InputFileError: if it has no trajectory.
    """
    require_trajectory(found, adt.TRAJECTORY_FILE)
    return replace(
        aria_inputs(root, found),
        points=point_cloud(found),
        glasses_size=ASSUMED_SIZE,
        turned=prepared_trajectory,
    )


def point_cloud(found: RecordingFiles) -> Path | None:
    """The semi-dense point cloud of the Machine Perception Services; None where there is none."""
    folder = found.folder / adt.MPS_FOLDER
    places = (folder / place / name for place in ("slam", "trajectory") for name in POINT_FILES)
    return next((place for place in places if place.is_file()), None)


def prepared_trajectory(glasses: adt.GlassesPoses) -> AriaTrajectory:
    """Poses of the device in the scene turned to Z up, every millisecond from the first to the last one.

    Gaps are bridged, since EgoAllo counts poses instead of reading clocks; bodies within them are taken for invalid
    when they are read.
    """
    device = _device_z_up(glasses)
    usable = device.valid if device.valid.any() else np.ones_like(device.valid)
    first, last = (int(glasses.time_us[usable][end]) for end in (0, -1))
    time_us = np.arange(first, last + 1, _STEP_US)
    position, rotation = device.pose_at(time_us / 1e6)
    return AriaTrajectory(
        time_us=time_us,
        position=position,
        rotation=rotation,
        quality=np.ones(len(time_us)),
        up=np.array([0.0, 0.0, 1.0]),
        graph_uids=(_GRAPH_UID,),
        left_out=0,
    )


def _device_z_up(glasses: adt.GlassesPoses) -> PoseStream:
    device = glasses_stream(glasses)
    turn = Rotation.from_matrix(adt.Z_UP_FROM_SCENE[:3, :3])
    rotation = turn * Rotation.from_quat(device.rotation, scalar_first=True)
    return PoseStream(device.times, turn.apply(device.position), rotation.as_quat(scalar_first=True), device.valid)
