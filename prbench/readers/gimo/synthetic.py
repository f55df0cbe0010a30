"""Native files of GIMO, route C: fitted root and translation, and the suit's skeleton.

Source: docs/specification/gimo.md#three-routes-to-the-22-joints.
"""

from __future__ import annotations

import csv
import io
import json
import pickle
import re
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.files.storage import atomic_folder, atomic_path, write_json, write_text
from prbench.geometry.skeleton import WRISTS, Joint
from prbench.geometry.timelines import interpolate
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo import synthetic_sensors as sensors
from prbench.readers.gimo.bvh import BvhMotion
from prbench.readers.gimo.to_recording import recording_from_gimo
from prbench.synthetic.layouts import SHARED_PARTS, Layout
from prbench.synthetic.people.truth import seen_again
from prbench.synthetic.performance import Performance, TrueEvent

_UNUSED_KEYS = {"lhand": 45, "rhand": 45, "beta": 10, "expression": 10, "jaw_pose": 3}
_CONE_POINTS = 8
_UNNAMED_COLUMNS = 3
_TEXT = re.compile(rb"X(?P<length>.{4})(?P<key>\d{6,20})", re.DOTALL)
_KEY = b"X" + struct.pack("<I", 1) + b"0"


def write_sequence(readings: gimo.GimoReadings, folder: Path) -> None:
    """Write the files of one sequence, complete or not at all.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    assert isinstance(readings.body, gimo.LocalSkeleton)  # synthetic bodies are suits
    with atomic_folder(folder) as target:
        transform = readings.transform
        write_json(
            target / readings.segment.transformation,
            {"scale": transform.scale, "transformation": transform.scene_from_body.tolist()},
        )
        _write_poses(readings.body.poses, target / gimo.POSE_FOLDER)
        _write_gaze(readings.gaze, target / gimo.GAZE_FOLDER)
        write_bvh(readings.body.motion, target / gimo.SKELETON_FILE)


def _write_poses(poses: gimo.SmplxPoses, folder: Path) -> None:
    """Write one pickle of torch tensors a frame, the root with ``requires_grad``, as the fitting program left them."""
    folder.mkdir(parents=True)
    zeros = {name: np.zeros(size, dtype=np.float32) for name, size in _UNUSED_KEYS.items()}
    for row, frame in enumerate(poses.frames):
        pose = {"orient": poses.orient[row], "trans": poses.trans[row], "latent": poses.latent[row], **zeros}
        (folder / f"{frame}.pkl").write_bytes(pickled_tensors(pose, requires_grad=("orient",)))


def pickled_tensors(values: Mapping[str, np.ndarray], *, requires_grad: Collection[str] = ()) -> bytes:
    """Return a pickled dictionary of torch tensors.

    Args:
        values: float32 arrays of one axis by name.
        requires_grad: Names of those that the writing program had optimised.
    """
    import torch

    tensors = {
        name: torch.tensor(array, dtype=torch.float32, requires_grad=name in requires_grad)
        for name, array in values.items()
    }
    buffer = io.BytesIO()
    _Pickler(buffer, protocol=4).dump(tensors)
    return buffer.getvalue()


class _Pickler(pickle.Pickler):
    """Writes storages from templates, everything else as usual."""

    def reducer_override(self, obj: Any) -> Any:
        import torch
        from torch.storage import TypedStorage, _load_from_bytes

        if not isinstance(obj, TypedStorage):
            return NotImplemented
        raw = torch.empty(0, dtype=torch.float32).set_(obj._untyped_storage).numpy().astype("<f4").tobytes()
        return _load_from_bytes, (_storage_head(len(raw) // 4) + raw,)


# torch writes the memory address of a storage as its key, so that equal tensors would give other bytes each time.
@cache
def _storage_head(size: int) -> bytes:
    """Return what ``torch.save`` writes before float32 numbers, with a fixed key for the memory address."""
    import torch

    buffer = io.BytesIO()
    torch.save(torch.zeros(size)._typed_storage(), buffer, _use_new_zipfile_serialization=False)
    head = buffer.getvalue()[: -4 * size]
    return _TEXT.sub(_fixed_key, head)


def _fixed_key(match: re.Match[bytes]) -> bytes:
    known = struct.unpack("<I", match["length"])[0]
    return _KEY + match["key"][known:] if known <= len(match["key"]) else match[0]


def _write_gaze(gaze: gimo.GazePoints, folder: Path) -> None:
    """Write two PLY files a frame: the point with copies of it beside it, and some points of the cone around it."""
    folder.mkdir(parents=True)
    around = np.linspace(-0.05, 0.05, _CONE_POINTS)[:, None] * np.ones(3)
    for frame, point in zip(gaze.frames, gaze.points, strict=True):
        (folder / f"{frame}{gimo.GAZE_CENTRE_SUFFIX}.ply").write_bytes(ply_bytes(np.stack([point, point + 0.001])))
        (folder / f"{frame}.ply").write_bytes(ply_bytes(point + around))


def ply_bytes(vertices: Float[np.ndarray, "v 3"]) -> bytes:
    """Return a binary PLY file of points with normals, as the dataset has them."""
    names = "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{names}end_header\n"
    rows = np.concatenate([vertices, np.tile([0.0, 1.0, 0.0], (len(vertices), 1))], axis=1)
    return header.encode() + rows.astype("<f8").tobytes()


def write_bvh(motion: BvhMotion, path: Path) -> None:
    """Write the hierarchy, whose joints stand in the order of a file, with an end site at every tip; six decimals."""
    lines = ["HIERARCHY", *_joint_lines(motion, 0, ""), "MOTION", f"Frames: {len(motion.values)}"]
    lines.append(f"Frame Time: {motion.frame_time!r}")
    lines += [" ".join(f"{value:.6f}" for value in row) for row in motion.values.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def _joint_lines(motion: BvhMotion, index: int, indent: str) -> list[str]:
    joint = motion.joints[index]
    inner = indent + "  "
    children = [child for child, other in enumerate(motion.joints) if other.parent == index]
    below = [line for child in children for line in _joint_lines(motion, child, inner)]
    tip = [f"{inner}End Site", f"{inner}{{", f"{inner}  OFFSET 0.0 5.0 0.0", f"{inner}}}"]
    return [
        f"{indent}{'ROOT' if joint.parent < 0 else 'JOINT'} {joint.name}",
        f"{indent}{{",
        f"{inner}OFFSET {' '.join(repr(value) for value in joint.offset)}",
        f"{inner}CHANNELS {len(joint.channels)} {' '.join(joint.channels)}",
        *(below or tip),
        f"{indent}}}",
    ]


def write_table(path: Path, segments: Sequence[gimo.Segment]) -> None:
    """Write ``dataset.csv`` as the fuller copies have it."""
    header = [*gimo.TABLE_COLUMNS, gimo.ACTIVITY_COLUMN, *[""] * _UNNAMED_COLUMNS]
    rows = [
        [
            segment.sequence,
            segment.start_frame,
            segment.end_frame,
            segment.scene,
            segment.transformation,
            segment.training,
            segment.activity,
            "" if segment.hint is None else segment.hint,
            *[""] * (_UNNAMED_COLUMNS - 1),
        ]
        for segment in segments
    ]
    _write_csv(path, [header, *rows], encoding="utf-8-sig")


def write_events(path: Path, events: Sequence[tuple[gimo.Segment, gimo.EventFrame]]) -> None:
    """Write the table of events that a user would have annotated."""
    rows = [
        [segment.scene, segment.sequence, segment.start_frame, segment.end_frame, event.frame, "pick", event.hand or ""]
        for segment, event in events
    ]
    _write_csv(path, [list(gimo.EVENT_COLUMNS), *rows], encoding="utf-8")


def _write_csv(path: Path, rows: Sequence[Sequence[object]], *, encoding: str) -> None:
    with atomic_path(path) as temporary, open(temporary, "w", encoding=encoding, newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def _matrix_text(matrix: Float[np.ndarray, "4 4"]) -> str:
    return "\n".join(" ".join(repr(value) for value in row) for row in matrix.tolist()) + "\n"


def _as_shown(performance: Performance) -> Performance:
    """Return the performance as the dataset can show it: rays from the head joint to the points on the scan."""
    points = sensors.looked_at(performance, performance.eye, performance.gaze)
    head = performance.joints[:, Joint.HEAD]
    apart = points - head
    return replace(performance, eye=head, gaze=apart / np.linalg.norm(apart, axis=1, keepdims=True))


def _as_known(shown: Performance, event: TrueEvent) -> TrueEvent:
    """Return a pick whose goal is the wrist on the annotated frame."""
    frame = sensors.event_frame(shown, event) - sensors.first_frame(shown)
    instant = np.array([shown.times[0] + frame / gimo.FRAME_RATE])
    wrist = interpolate(shown.times, shown.joints[:, WRISTS[event.hand == "right"]], instant)[0]
    return replace(seen_again(event, shown, wrist, wrist, gaze_period=1 / gimo.FRAME_RATE), goal=wrist)


def _write_below(readings: gimo.GimoReadings, root: Path) -> None:
    """Write one folder a sequence, in the folder of its scene."""
    segment = readings.segment
    write_sequence(readings, root / segment.scene / segment.sequence)
    norm = root / segment.scene / gimo.SCENE_FOLDER / gimo.NORM_FILE
    write_text(norm, _matrix_text(readings.transform.room_from_scene))
    events = [[event.frame, event.hand] for event in readings.events]
    write_json(root / SHARED_PARTS / f"{readings.recording_id}.json", {"segment": asdict(segment), "events": events})


def _finish(root: Path) -> None:
    """Write ``dataset.csv`` (byte-order mark, unnamed columns, one repeated row) and the table of events."""
    parts = [json.loads(path.read_text("utf-8")) for path in sorted((root / SHARED_PARTS).glob("*.json"))]
    segments = [gimo.Segment(**part["segment"]) for part in parts]
    write_table(root / gimo.TABLE_FILE, [*segments, segments[-1]])
    events = [
        (segment, gimo.EventFrame(frame, hand))
        for segment, part in zip(segments, parts, strict=True)
        for frame, hand in part["events"]
    ]
    write_events(root / gimo.EVENTS_FILE, events)


def _events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return picks alone, with the wrist as goal, and primes as rays from the head joint to the scan show them."""
    shown = _as_shown(performance)
    return tuple(_as_known(shown, event) for event in sensors.picks(performance))


LAYOUT = Layout(
    dataset="gimo",
    sense=sensors.sense,
    to_recording=recording_from_gimo,
    write=_write_below,
    finish=_finish,
    events=_events,
    clock_start=lambda performance: sensors.first_frame(performance) / gimo.FRAME_RATE,
    object_id=lambda _: gimo.OBJECT_ID,  # the dataset knows one target and no objects
    gaze_bias=sensors.gaze_bias,
)
