"""A small synthetic HOT3D recording for tests of its reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from prbench.files.storage import write_json
from prbench.readers.aria_mps.format import MpsReadings, trajectory_rows
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import synthetic as layout
from prbench.synthetic.layouts import SHARED_PARTS


def first_seconds(readings: hot3d.Hot3dReadings, seconds: float) -> hot3d.Hot3dReadings:
    """The beginning of a recording, without bodies: quick to write and to read."""
    end_ns = int(readings.headset.time_ns[0] + seconds * 1e9)

    def cut(rows: hot3d.PoseRows) -> hot3d.PoseRows:
        kept = rows.time_ns <= end_ns
        return hot3d.PoseRows(rows.time_ns[kept], rows.position[kept], rows.rotation[kept])

    def cut_hand(rows: hot3d.HandRows) -> hot3d.HandRows:
        kept = rows.time_ns <= end_ns
        poses = cut(hot3d.PoseRows(rows.time_ns, rows.position, rows.rotation))
        return replace(
            rows, time_ns=poses.time_ns, position=poses.position, rotation=poses.rotation, angles=rows.angles[kept]
        )

    return replace(
        readings,
        headset=cut(readings.headset),
        objects=tuple(replace(entry, rows=cut(entry.rows)) for entry in readings.objects),
        hands=tuple(cut_hand(hand) for hand in readings.hands),
        masks={name: (times[times <= end_ns], good[times <= end_ns]) for name, (times, good) in readings.masks.items()},
        mps=_cut_mps(readings.mps, seconds),
        body=None,
        egoallo_outputs=(),
    )


def _cut_mps(mps: MpsReadings, seconds: float) -> MpsReadings:
    end_us = int(mps.trajectory.time_us[0] + seconds * 1e6)
    kept = mps.gaze.time_us <= end_us
    columns = {name: getattr(mps.gaze, name)[kept] for name in mps.gaze.__dataclass_fields__}
    rows = np.flatnonzero(mps.trajectory.time_us <= end_us)
    return replace(mps, trajectory=trajectory_rows(mps.trajectory, rows), gaze=replace(mps.gaze, **columns))


def write_tree(readings: hot3d.Hot3dReadings, root: Path, *, folder: str = "", library: str = "assets") -> Path:
    """One recording and its object library, as downloaded; returns the recording's folder."""
    place = root / folder / readings.recording_id
    layout.write(readings, place)
    part = root / SHARED_PARTS / readings.recording_id
    layout.write_library_part(readings, part)
    part.rename(root / library)
    (root / SHARED_PARTS).rmdir()
    return place


def change_metadata(folder: Path, **entries: object) -> None:
    """Write other entries into ``metadata.json``."""
    status = {"mano_hand_pose_gt": False, "object_pose_gt": True, "umetrack_hand_pose_gt": True}
    content = {
        "gt_available_status": status,
        "headset": "Aria",
        "participant_id": "P0003",
        "recording_name": folder.name,
    }
    write_json(folder / hot3d.METADATA_FILE, content | entries)
