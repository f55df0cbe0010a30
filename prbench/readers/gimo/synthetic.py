"""What GIMO's suit and glasses see of synthetic people, and its native files, route C.

Sources: docs/specification/synthetic-recordings.md#sensors (rows "gimo"), #native-layouts, and
docs/specification/gimo.md#two-routes-to-the-22-joints. The learned pose decoder cannot be imitated, so the fitted
parameters hold root and translation only, and limbs come from the skeleton of the inertial suit.
"""

from __future__ import annotations

import copyreg
import csv
import io
import json
import pickle
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_folder, atomic_path, write_json, write_text
from prbench.geometry.skeleton import PARENTS, WRISTS, Joint, invert_rigid, transform_points
from prbench.geometry.timelines import interpolate, slerp
from prbench.randomness import named_generator
from prbench.readers.aria_mps.format import gaze_directions_cpf
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.bvh import POSITION_CHANNELS, BvhJoint, BvhMotion, write_bvh
from prbench.readers.gimo.pickles import STORAGE
from prbench.readers.gimo.to_recording import recording_from_gimo
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.layouts import SHARED_PARTS, Layout
from prbench.synthetic.people.truth import seen_again
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors import Sensing, Switches, measured_gaze, sensor_generator

Vectors = Float[np.ndarray, "n 3"]
Numbers = Float[np.ndarray, " n"]
Transform = Float[np.ndarray, "4 4"]

_SKELETON_RATE = 60.0  # Frames of the suit a second.
_TRANSFORMATION = "transform_info_0.json"
_ACTIVITY = "take object"

_FIRST_FRAMES = 300  # of the video, before the segment
_SKELETON_LEAD = (20, 90)  # frames of the suit before the segment: its clock is its own
_GAZE_BIAS = _GAZE_JITTER = np.deg2rad(1.0) / 2  # per axis and each: 1 degree of all four together
_GAZE_LOSS = 0.25
_ROOT_NOISE = 1e-3  # m, degrees
_ANGLE_NOISE = 0.1
_SCALE = (0.98, 1.06)
_CEILING = 2.6  # m
_BEHIND_FURNITURE = 0.3
_CENTIMETRES = 100.0
_DECIMALS = 6
_EULER = ("Yrotation", "Xrotation", "Zrotation")

SKELETON_NAMES = (
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot", "Spine2",
    "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm",
    "LeftForeArm", "RightForeArm", "LeftHand", "RightHand",
)  # fmt: skip


def _depth_first(joint: int = 0) -> tuple[int, ...]:
    below = [child for child, parent in enumerate(PARENTS) if parent == joint]
    return (joint, *(each for child in below for each in _depth_first(child)))


DEPTH_FIRST = _depth_first()  # The 22 joints in the order in which a BVH file lists them.


def sense(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> gimo.GimoReadings:
    """Return what the sensors of a GIMO segment say about a performance.

    Args:
        performance: The truth; any rate, usually 120 Hz.
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
        switches: Which errors are on; all if None.
    """
    sensing = Sensing(performance, noise, switches or Switches())
    # The row of ``dataset.csv``: the whole performance is one segment.
    start = first_frame(performance)
    known = [event_frame(performance, event) for event in picks(performance)]
    train = gimo.TRAIN_LATER if performance.index % 3 == 2 else gimo.TRAIN
    training = gimo.TEST if performance.split == "test" else train
    hint = known[0] if known and performance.index % 2 else None
    ends = (start, start + int((performance.duration + 1e-9) * gimo.FRAME_RATE))
    names = (performance.room_id, performance.recording_id)
    segment = gimo.Segment(*names, *ends, _TRANSFORMATION, training, _ACTIVITY, hint)
    # Draw how suit and scan lie in the room. The scan, with its scale, belongs to the room: others share it.
    seed = (performance.seed, performance.preset, performance.world)
    room = named_generator("prbench-synth", GENERATOR_VERSION, *seed, "room", performance.room_id, "scan")
    scale = float(np.round(room.uniform(*_SCALE), 4))
    room_from_scene = np.eye(4)
    room_from_scene[:3, :3] = Rotation.from_rotvec(room.normal(size=3)).as_matrix()
    room_from_scene[:3, 3] = room.uniform(-2.0, 2.0, 3)
    own = sensor_generator(performance, "suit-frame")
    room_from_body = np.eye(4)
    room_from_body[:3, :3] = Rotation.from_euler("y", own.uniform(-np.pi, np.pi)).as_matrix()
    room_from_body[[0, 2], 3] = own.uniform(-2.0, 2.0, 2)
    scene_from_body = invert_rigid(room_from_scene) @ room_from_body
    for matrix in (room_from_scene, scene_from_body):
        matrix[:3, 3] *= scale
    transform = gimo.SceneTransform(scale, scene_from_body, room_from_scene)
    body_from_room = invert_rigid(transform.room_from_body())
    times = performance.times[0] + np.arange(len(segment.frames)) / gimo.FRAME_RATE
    head = sensing.head(times)
    gaze = sensing.gaze(times)
    gaze /= np.linalg.norm(gaze, axis=1, keepdims=True)
    angles = measured_gaze(sensing, head, gaze, bias=_GAZE_BIAS, jitter=_GAZE_JITTER)
    directions = head.apply(gaze_directions_cpf(angles[:, 0], angles[:, 1]))
    points = looked_at(sensing.performance, sensing.eye(times), directions)
    lost = sensing.generator("gaze-losses").random(len(times)) < _GAZE_LOSS * sensing.strength("gaze_losses")
    scan_from_room = np.linalg.inv(transform.room_from_scan())
    poses = _sense_poses(sensing, segment.frames, times, body_from_room)
    body = gimo.LocalSkeleton(_sense_skeleton(sensing, body_from_room), poses)
    seen = gimo.GazePoints(segment.frames[~lost], transform_points(scan_from_room, points)[~lost])
    events = tuple(gimo.EventFrame(frame, event.hand) for frame, event in zip(known, picks(performance), strict=True))
    return gimo.GimoReadings(performance.recording_id, segment, transform, body, seen, events)


def first_frame(performance: Performance) -> int:
    """Return the video frame of the performance's first instant: the segment is a part of a longer video."""
    return int(sensor_generator(performance, "clock").integers(_FIRST_FRAMES))


def event_frame(performance: Performance, event: TrueEvent) -> int:
    """Return the frame that an annotator would name."""
    return first_frame(performance) + round((event.event_time - float(performance.times[0])) * gimo.FRAME_RATE)


def picks(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return events that an annotator would list: picks; no doors, and nothing that only looks like a pick."""
    others = ("not_an_event", "excluded_category", "other_wearer")
    return tuple(event for event in performance.events if event.action == "pick" and event.expected not in others)


def looked_at(performance: Performance, origin: Vectors, direction: Vectors) -> Vectors:
    """Return where rays meet the scanned room: its walls, furniture and objects as they stood in the beginning.

    Args:
        performance: Whose room.
        origin: Inside the room, metres.
        direction: Unit vectors.
    """
    boxes = performance.objects
    places = np.concatenate([[motion.position[0] for motion in boxes], origin])
    margin = np.array([_BEHIND_FURNITURE, 0.0, _BEHIND_FURNITURE])
    low = places.min(axis=0) - margin
    high = places.max(axis=0) + margin
    low[1], high[1] = 0.0, max(float(high[1]), _CEILING)
    _, distance = _crossings(origin, direction, low, high)
    for motion in boxes:
        turned = Rotation.from_quat(motion.rotation[0], scalar_first=True).inv()
        half = motion.half_extents
        enters, leaves = _crossings(turned.apply(origin - motion.position[0]), turned.apply(direction), -half, half)
        distance = np.where((enters > 0) & (enters < leaves), np.minimum(distance, enters), distance)
    return origin + distance[:, None] * direction


def _crossings(origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[Numbers, Numbers]:
    """Return the distances at which rays cross the last plane of a box before it and the first one behind it."""
    with np.errstate(divide="ignore"):  # a ray along a plane crosses it infinitely far away
        inverse = 1.0 / direction
    one = (low - origin) * inverse
    other = (high - origin) * inverse
    return np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)


def _sense_poses(sensing: Sensing, frames: np.ndarray, times: np.ndarray, body_from_room: Transform) -> gimo.SmplxPoses:
    performance = sensing.performance
    pelvis = interpolate(performance.times, performance.joints[:, Joint.PELVIS], times)
    pelvis = transform_points(body_from_room, pelvis)
    noise = sensing.generator("fit-noise").normal(0.0, _ROOT_NOISE, pelvis.shape)
    pelvis = pelvis + noise * sensing.strength("body_noise")
    turned = slerp(performance.times, performance.rotations[:, Joint.PELVIS], times)
    orient = Rotation.from_matrix(body_from_room[:3, :3]) * Rotation.from_quat(turned, scalar_first=True)
    trans = (pelvis - np.array(gimo.REST_PELVIS)).astype(np.float32)
    latent = np.zeros((len(times), gimo.N_LATENT), dtype=np.float32)
    return gimo.SmplxPoses(frames, orient.as_rotvec().astype(np.float32), trans, latent)


def _sense_skeleton(sensing: Sensing, body_from_room: Transform) -> BvhMotion:
    """Return the suit's own file: centimetres, starting earlier than the segment with the first pose held."""
    performance = sensing.performance
    lead = int(sensor_generator(performance, "suit-clock").integers(*_SKELETON_LEAD))
    n = int((performance.duration + 1e-9) * _SKELETON_RATE) + 1
    times = performance.times[0] + np.maximum(np.arange(-lead, n), 0) / _SKELETON_RATE
    turned = []
    for joint in range(len(PARENTS)):
        in_room = slerp(performance.times, performance.rotations[:, joint], times)
        turned.append(Rotation.from_matrix(body_from_room[:3, :3]) * Rotation.from_quat(in_room, scalar_first=True))
    hips = transform_points(body_from_room, interpolate(performance.times, performance.joints[:, Joint.PELVIS], times))
    columns = [hips * _CENTIMETRES]
    for joint in DEPTH_FIRST:
        parent = PARENTS[joint]
        local = turned[joint] if parent < 0 else turned[parent].inv() * turned[joint]
        columns.append(local.as_euler("YXZ", degrees=True))
    values = np.concatenate(columns, axis=1)
    size = np.full(values.shape[1], _ANGLE_NOISE)
    size[:3] = _ROOT_NOISE * _CENTIMETRES
    values += sensing.generator("suit-noise").normal(0.0, 1.0, values.shape) * size * sensing.strength("body_noise")
    # Joints as a BVH file lists them: each with everything below it before its next sibling.
    joints = []
    for joint in DEPTH_FIRST:
        parent = PARENTS[joint]
        if parent < 0:
            joints.append(BvhJoint(SKELETON_NAMES[joint], -1, (0.0, 0.0, 0.0), (*POSITION_CHANNELS, *_EULER)))
            continue
        apart = performance.joints[0, joint] - performance.joints[0, parent]
        own = Rotation.from_quat(performance.rotations[0, parent], scalar_first=True).inv().apply(apart)
        x, y, z = np.round(own * _CENTIMETRES, _DECIMALS).tolist()
        joints.append(BvhJoint(SKELETON_NAMES[joint], DEPTH_FIRST.index(parent), (x, y, z), _EULER))
    return BvhMotion(tuple(joints), 1.0 / _SKELETON_RATE, np.round(values, _DECIMALS))


_UNUSED_KEYS = {"lhand": 45, "rhand": 45, "beta": 10, "expression": 10, "jaw_pose": 3}
_CONE_POINTS = 8
_UNNAMED_COLUMNS = 3


def write_sequence(readings: gimo.GimoReadings, folder: Path) -> None:
    """Write the files of one sequence, complete or not at all.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    assert isinstance(readings.body, gimo.LocalSkeleton)  # synthetic bodies are suits
    with atomic_folder(folder) as target:
        transform = readings.transform
        content = {"scale": transform.scale, "transformation": transform.scene_from_body.tolist()}
        write_json(target / readings.segment.transformation, content)
        # One pickle of torch tensors a frame, the root with ``requires_grad``, as the fitting program left them.
        poses = readings.body.poses
        zeros = {name: np.zeros(size, dtype=np.float32) for name, size in _UNUSED_KEYS.items()}
        (target / gimo.POSE_FOLDER).mkdir(parents=True)
        for row, frame in enumerate(poses.frames):
            pose = {"orient": poses.orient[row], "trans": poses.trans[row], "latent": poses.latent[row], **zeros}
            content = pickled_tensors(pose, requires_grad=("orient",))
            (target / gimo.POSE_FOLDER / f"{frame}.pkl").write_bytes(content)
        # Two PLY files a frame: the point with a copy of it beside it, and some points of the cone around it.
        folder = target / gimo.GAZE_FOLDER
        folder.mkdir(parents=True)
        around = np.linspace(-0.05, 0.05, _CONE_POINTS)[:, None] * np.ones(3)
        for frame, point in zip(readings.gaze.frames, readings.gaze.points, strict=True):
            (folder / f"{frame}{gimo.GAZE_CENTRE_SUFFIX}.ply").write_bytes(ply_bytes(np.stack([point, point + 0.001])))
            (folder / f"{frame}.ply").write_bytes(ply_bytes(point + around))
        write_bvh(readings.body.motion, target / gimo.SKELETON_FILE)


def pickled_tensors(values: Mapping[str, np.ndarray], *, requires_grad: Collection[str] = ()) -> bytes:
    """Return a pickled dictionary of torch tensors.

    Args:
        values: float32 arrays of one axis by name.
        requires_grad: Names of those that the writing program had optimised.
    """
    import torch
    from torch.storage import TypedStorage, _load_from_bytes

    def reduced(storage: Any) -> Any:
        raw = torch.empty(0, dtype=torch.float32).set_(storage._untyped_storage).numpy().astype("<f4").tobytes()
        return _load_from_bytes, (_storage_head(len(raw) // 4) + raw,)

    tensors = {}
    for name, array in values.items():
        tensors[name] = torch.tensor(array, dtype=torch.float32, requires_grad=name in requires_grad)
    buffer = io.BytesIO()
    pickler = pickle.Pickler(buffer, protocol=4)
    pickler.dispatch_table = copyreg.dispatch_table | {TypedStorage: reduced}
    pickler.dump(tensors)
    return buffer.getvalue()


@cache
def _storage_head(size: int) -> bytes:
    """Return what ``torch.save`` writes before float32 numbers, with a fixed key in the place of the memory address.

    The address would give equal tensors other bytes each time.
    """
    import torch

    buffer = io.BytesIO()
    torch.save(torch.zeros(size)._typed_storage(), buffer, _use_new_zipfile_serialization=False)
    head = buffer.getvalue()[: -4 * size]
    match = STORAGE.match(buffer.getvalue())
    assert match is not None, "our own reader knows the form"
    return head.replace(match["length"] + bytes(3) + match["key"], b"\x01" + bytes(3) + b"0")


def ply_bytes(vertices: Float[np.ndarray, "v 3"]) -> bytes:
    """Return a binary PLY file of points with normals, as the dataset has them."""
    names = "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{names}end_header\n"
    rows = np.concatenate([vertices, np.tile([0.0, 1.0, 0.0], (len(vertices), 1))], axis=1)
    return header.encode() + rows.astype("<f8").tobytes()


def write_table(path: Path, segments: Sequence[gimo.Segment]) -> None:
    """Write ``dataset.csv`` as the fuller copies have it."""
    header = [*gimo.TABLE_COLUMNS, gimo.ACTIVITY_COLUMN, *[""] * _UNNAMED_COLUMNS]
    rows = []
    for segment in segments:
        frames = (segment.start_frame, segment.end_frame)
        named = [segment.sequence, *frames, segment.scene, segment.transformation, segment.training, segment.activity]
        rows.append([*named, "" if segment.hint is None else segment.hint, *[""] * (_UNNAMED_COLUMNS - 1)])
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


def _write_below(readings: gimo.GimoReadings, root: Path) -> None:
    """Write one folder a sequence, in the folder of its scene."""
    segment = readings.segment
    write_sequence(readings, root / segment.scene / segment.sequence)
    rows = [" ".join(repr(value) for value in row) for row in readings.transform.room_from_scene.tolist()]
    write_text(root / segment.scene / gimo.SCENE_FOLDER / gimo.NORM_FILE, "\n".join(rows) + "\n")
    events = [[event.frame, event.hand] for event in readings.events]
    write_json(root / SHARED_PARTS / f"{readings.recording_id}.json", {"segment": asdict(segment), "events": events})


def _finish(root: Path) -> None:
    """Write ``dataset.csv`` (byte-order mark, unnamed columns, one repeated row) and the table of events."""
    parts = [json.loads(path.read_text("utf-8")) for path in sorted((root / SHARED_PARTS).glob("*.json"))]
    segments = [gimo.Segment(**part["segment"]) for part in parts]
    write_table(root / gimo.TABLE_FILE, [*segments, segments[-1]])
    events: list[tuple[gimo.Segment, gimo.EventFrame]] = []
    for segment, part in zip(segments, parts, strict=True):
        events += [(segment, gimo.EventFrame(frame, hand)) for frame, hand in part["events"]]
    write_events(root / gimo.EVENTS_FILE, events)


def _events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return picks alone, with the wrist as goal, and primes as rays from the head joint to the scan show them."""
    # The performance as the dataset can show it: rays from the head joint to the points on the scan.
    points = looked_at(performance, performance.eye, performance.gaze)
    head = performance.joints[:, Joint.HEAD]
    apart = points - head
    shown = replace(performance, eye=head, gaze=apart / np.linalg.norm(apart, axis=1, keepdims=True))
    known = []
    for event in picks(performance):
        instant = np.array([shown.times[0] + (event_frame(shown, event) - first_frame(shown)) / gimo.FRAME_RATE])
        wrist = interpolate(shown.times, shown.joints[:, WRISTS[event.hand == "right"]], instant)[0]
        known.append(replace(seen_again(event, shown, wrist, wrist, gaze_period=1 / gimo.FRAME_RATE), goal=wrist))
    return tuple(known)


LAYOUT = Layout(
    dataset="gimo",
    sense=sense,
    to_recording=recording_from_gimo,
    write=_write_below,
    finish=_finish,
    events=_events,
    clock_start=lambda performance: first_frame(performance) / gimo.FRAME_RATE,
    object_id=lambda _: gimo.OBJECT_ID,  # the dataset knows one target and no objects
    gaze_bias=_GAZE_BIAS,
)
