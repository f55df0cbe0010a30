"""What MoGaze's sensors see of synthetic people, and its native files: four HDF5 files a recording, a scene for all.

Source: docs/specification/synthetic-recordings.md#sensors, rows "mogaze". The human model has fewer joints than the
performance's spine, and every link hangs on its parent along fixed axes. So each link's frame is the segment's, tipped
until the child lies where the model wants it. Everything is exact but the distance from pelvis to torso, which is
fixed: where the back bends, the upper body is up to a centimetre further along the trunk (#native-layouts there).
"""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_path, write_json, write_text
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, Joint
from prbench.geometry.timelines import interpolate, slerp
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps.format import gaze_directions_cpf
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.format import LINKS, MODEL_OFFSETS, OFFSET_KEYS, PARENT_LINKS, STATE_COLUMNS
from prbench.readers.mogaze.to_recording import recording_from_mogaze
from prbench.synthetic import sensors
from prbench.synthetic.layouts import SHARED_PARTS, Layout
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent

Times = Float[np.ndarray, " n"]
Size = Float[np.ndarray, "3"]

_TO_WORLD = Y_UP_FROM_Z_UP[:3, :3]
# Columns: the link's axes (left, back, up) in the frame of a trunk segment (left, up, forward).
_SEGMENT_AXES = _TO_WORLD
# Axes of arms, whose segments have y along the bone and x along the hinge; arms are spread at zero angles.
_ARM_AXES = {"l": np.array([(0, 1, 0), (0, 0, 1), (1, 0, 0)]).T, "r": np.array([(0, -1, 0), (0, 0, 1), (-1, 0, 0)]).T}
_LEG_AXES = np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)]).T  # Axes of legs, which hang at zero angles.

_JOINT_OF_LINK: dict[str, Joint] = {
    "pelvis": Joint.PELVIS, "torso": Joint.SPINE3, "neck": Joint.NECK, "head": Joint.HEAD,
    "linnerShoulder": Joint.LEFT_COLLAR, "lShoulder": Joint.LEFT_SHOULDER, "lElbow": Joint.LEFT_ELBOW,
    "lWrist": Joint.LEFT_WRIST, "rinnerShoulder": Joint.RIGHT_COLLAR, "rShoulder": Joint.RIGHT_SHOULDER,
    "rElbow": Joint.RIGHT_ELBOW, "rWrist": Joint.RIGHT_WRIST, "lHip": Joint.LEFT_HIP, "lKnee": Joint.LEFT_KNEE,
    "lAnkle": Joint.LEFT_ANKLE, "lToe": Joint.LEFT_FOOT, "rHip": Joint.RIGHT_HIP, "rKnee": Joint.RIGHT_KNEE,
    "rAnkle": Joint.RIGHT_ANKLE, "rToe": Joint.RIGHT_FOOT,
}  # fmt: skip


def solve_body(
    joints: Float[np.ndarray, "n 22 3"], rotations: Float[np.ndarray, "n 22 4"]
) -> tuple[Float[np.ndarray, "n 66"], dict[str, float]]:
    """Solve the joint state and the fixed offsets of a performance.

    Args:
        joints: World frame, Y up, metres.
        rotations: See :attr:`prbench.synthetic.performance.Performance.rotations`.

    Returns:
        The state without noise (columns as in :data:`prbench.readers.mogaze.format.STATE_COLUMNS`), and the 60 scaling
        values, metres.
    """
    hips = (joints[:, Joint.LEFT_HIP] + joints[:, Joint.RIGHT_HIP]) / 2
    places = {"base": hips} | {link: joints[:, joint] for link, joint in _JOINT_OF_LINK.items()}
    # The rotations that take each link to the world (Y up).
    segment = {joint: Rotation.from_quat(rotations[:, joint], scalar_first=True) for joint in Joint}
    trunk = Rotation.from_matrix(_SEGMENT_AXES)
    leg = Rotation.from_matrix(_LEG_AXES)
    pelvis = segment[Joint.PELVIS] * trunk
    chest = segment[Joint.SPINE3] * trunk
    turned = {
        "base": _tipped(pelvis, "Z", places["pelvis"] - places["base"]),
        "pelvis": _tipped(pelvis, "Z", places["torso"] - places["pelvis"]),
        "torso": _tipped(chest, "Z", places["neck"] - places["torso"]),
        "neck": segment[Joint.NECK] * trunk,
        "head": segment[Joint.HEAD] * trunk,
    }
    for side, letter in enumerate("lr"):
        arm = Rotation.from_matrix(_ARM_AXES[letter])
        inner, outer = (places[f"{letter}{name}"] for name in ("innerShoulder", "Shoulder"))
        outwards = outer - inner if letter == "l" else inner - outer
        turned[f"{letter}innerShoulder"] = _tipped(chest, "X", outwards)
        left_arm = {"Shoulder": Joint.LEFT_SHOULDER, "Elbow": Joint.LEFT_ELBOW, "Wrist": Joint.LEFT_WRIST}
        for name, joint in left_arm.items():
            turned[f"{letter}{name}"] = segment[Joint(joint + side)] * arm
        for name, joint in (("Hip", Joint.LEFT_HIP), ("Knee", Joint.LEFT_KNEE)):
            turned[f"{letter}{name}"] = segment[Joint(joint + side)] * leg
        for name, joint in (("Ankle", Joint.LEFT_ANKLE), ("Toe", Joint.LEFT_FOOT)):
            turned[f"{letter}{name}"] = segment[Joint(joint + side)] * trunk
    # Offsets without a joint in the model are nothing but zeros.
    fixed = dict.fromkeys(OFFSET_KEYS, 0.0)
    to_native = Rotation.from_matrix(_TO_WORLD.T)
    angles = [(to_native * turned["base"]).as_euler("XYZ")]
    for link in LINKS[1:]:
        parent = PARENT_LINKS[link]
        inverse = turned[parent].inv()
        angles.append((inverse * turned[link]).as_euler("XYZ"))
        local = inverse.apply(places[link] - places[parent])
        middle = local[int(np.argmax(local[:, 2]))] if link == "torso" else np.median(local, axis=0)
        for axis, letter in enumerate("XYZ"):
            key = f"{link}Trans{letter}"
            if key in MODEL_OFFSETS:
                fixed[key] = float(middle[axis])
    return np.hstack([to_native.apply(hips), *angles]), fixed


def _tipped(frames: Rotation, axis: str, towards: Float[np.ndarray, "n 3"]) -> Rotation:
    """Turn frames by the smallest angle that brings one of their axes onto a direction."""
    present = frames.as_matrix()[:, :, "XYZ".index(axis)]
    wanted = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    about = np.cross(present, wanted)
    sine = np.linalg.norm(about, axis=1, keepdims=True)
    angle = np.arctan2(sine, np.einsum("ni,ni->n", present, wanted)[:, None])
    return Rotation.from_rotvec(about * np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-12)) * frames


GOGGLES_ID = 1

GAZE_BIAS = np.deg2rad(0.8) / np.sqrt(2)
_GAZE_JITTER = np.deg2rad(0.5)
_DEPTH = (0.4, 2.0)  # m
_MIRRORED = 0.01  # share of the gaze points that the tracker writes behind itself
_CONFIDENT = (0.8, 1.0)
_BLINKING = (0.0, 0.3)
_BODY_TURN = np.deg2rad(0.1)
_ROOT_NOISE = 1e-3
_OBJECT_NOISE = (0.5e-3, np.deg2rad(0.1))  # m, rad

_TO_NATIVE = Rotation.from_matrix(Y_UP_FROM_Z_UP[:3, :3].T)
# The eye tracker's camera: x right, y down, z forward; the face: x left, y up, z forward.
_FACE_FROM_TRACKER = Rotation.from_matrix(np.diag([-1.0, -1.0, 1.0]))
_UPRIGHT_FROM_Z_UP = Rotation.from_matrix(np.transpose([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)]))
_Z_UP_KINDS = ("plate", "jug")


def sense(
    performance: Performance, *, noise: float = 1.0, switches: sensors.Switches | None = None
) -> mogaze.MogazeReadings:
    """Return what the sensors of a MoGaze recording say about a performance.

    Args:
        performance: The truth; any rate, usually 120 Hz.
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
        switches: Which errors are on; all if None.
    """
    sensing = sensors.Sensing(performance, noise, switches or sensors.Switches())
    times = sensing.times(mogaze.RATE)
    acted = sensing.performance
    joints = interpolate(acted.times, acted.joints, times)
    turned = [_turned(acted, acted.rotations[:, joint], times) for joint in range(joints.shape[1])]
    state, fixed = solve_body(joints, np.stack(turned, axis=1))
    noise_of_body = sensing.generator("body-noise-0")
    shift = noise_of_body.normal(0.0, _ROOT_NOISE, (len(times), 3))
    tremble = noise_of_body.normal(0.0, _BODY_TURN, (len(times), state.shape[1] - 3))
    state = state + np.hstack([shift, tremble]) * sensing.strength("body_noise")
    # Draw the rotation from the eye tracker's camera to the goggles, another one in every recording.
    tracker = Rotation.from_quat(sensors.sensor_generator(performance, "calibration").normal(size=4))
    # The gaze points in the eye tracker's camera, millimetres, and confidence.
    head = _head(sensing.performance, times)
    angles = sensors.measured_gaze(sensing, head, sensing.gaze(times), bias=GAZE_BIAS, jitter=_GAZE_JITTER)
    depth = np.clip(sensors.fixation_depth(sensing, times, _DEPTH[1]), *_DEPTH)  # as far as the tracker tells distances
    points = _FACE_FROM_TRACKER.inv().apply(gaze_directions_cpf(*angles.T)) * depth[:, None] * 1e3
    rng = sensing.generator("gaze-quality")
    points[rng.random(len(times)) < _MIRRORED] *= -1.0
    confidence = rng.uniform(*_CONFIDENT, len(times))
    doubt = rng.uniform(*_BLINKING, len(times))
    garbage = rng.normal(0.0, 300.0, points.shape)
    closed = sensors.closed_eyes(sensing, times)
    points, confidence = np.where(closed[:, None], garbage, points), np.where(closed, doubt, confidence)
    names = body_names(performance)
    turned = _TO_NATIVE * _head(sensing.performance, times) * _FACE_FROM_TRACKER * tracker.inv()
    position = _TO_NATIVE.apply(sensing.eye(times))
    scale = sensing.strength("object_noise")
    position, rotation = sensors.tracked(sensing, "goggles", position, turned, size=_OBJECT_NOISE, scale=scale)
    quaternion = rotation.as_quat(canonical=True)
    bodies = [mogaze.MogazeBody(GOGGLES_ID, mogaze.GOGGLES, position, quaternion, np.zeros(3), np.zeros(3))]
    bodies += [_sense_object(sensing, motion, names[motion.object_id], times) for motion in performance.objects]
    # Alternate nothing and an object; a segment begins with the last frame of the one before it, or one later.
    n_frames = len(times)
    rng = sensors.sensor_generator(performance, "segment-borders")
    segments: list[mogaze.Segment] = []
    free_from = 0
    for start, end, label in _carries(performance, names, n_frames):
        segments.append(mogaze.Segment(free_from, start - int(rng.integers(2)), mogaze.NULL_LABEL))
        segments.append(mogaze.Segment(start, end, label))
        free_from = end + int(rng.integers(2))
    if free_from < n_frames - 1:
        segments.append(mogaze.Segment(free_from, n_frames - 1, mogaze.NULL_LABEL))
    identity = (performance.recording_id, performance.person.participant_id)
    bodies.sort(key=lambda body: body.body_id)
    sensed = (points, confidence, tracker.as_quat(canonical=True))
    return mogaze.MogazeReadings(*identity, state, fixed, tuple(bodies), *sensed, tuple(segments))


def events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return events as the annotators of this dataset would know them: nobody annotates doors."""
    return tuple(event for event in performance.events if event.tag != "hinge")


def body_names(performance: Performance) -> dict[str, str]:
    """Map each object's id to a name: its own, with a number where another object has it already."""
    names: dict[str, str] = {}
    used = Counter[str]()
    for motion in performance.objects:
        used[motion.name] += 1
        number = used[motion.name]
        names[motion.object_id] = motion.name if number == 1 else f"{motion.name}_{number}"
    return names


def _turned(performance: Performance, rotation: Float[np.ndarray, "m 4"], times: Times) -> Float[np.ndarray, "n 4"]:
    """Interpolate rotations at the sensors' times; at the performance's own, the usual case, take them as they are."""
    if len(rotation) == len(times) and np.array_equal(performance.times, times):
        return rotation
    return slerp(performance.times[: len(rotation)], rotation, times)


def _head(performance: Performance, times: Times) -> Rotation:
    return Rotation.from_quat(_turned(performance, performance.head_rotation, times), scalar_first=True)


def _sense_object(sensing: sensors.Sensing, motion: ObjectMotion, name: str, times: Times) -> mogaze.MogazeBody:
    performance = sensing.performance
    low, high, upright_from_body = _shape(motion, name)
    track = performance.times[: len(motion.position)]
    turned = Rotation.from_quat(_turned(performance, motion.rotation, times), scalar_first=True) * upright_from_body
    true = _TO_NATIVE.apply(interpolate(track, motion.position, times) - turned.apply((low + high) / 2))
    scale = sensing.strength("object_noise") if motion.movable else 0.0
    rotation = _TO_NATIVE * turned
    position, rotation = sensors.tracked(sensing, motion.object_id, true, rotation, size=_OBJECT_NOISE, scale=scale)
    quaternion = rotation.as_quat(canonical=True)
    # A body out of sight: the release has NaN for its place and zeros for its rotation.
    lost = sensors.untracked(performance, motion, times)
    position[lost] = np.nan
    quaternion[lost] = 0.0
    return mogaze.MogazeBody(int(motion.object_id), name, position, quaternion, low, high)


def _shape(motion: ObjectMotion, name: str) -> tuple[Size, Size, Rotation]:
    """Return the box in the body's own frame, and that frame's axes in the performance's."""
    kind = mogaze.kind_of_body(name)
    upright = Rotation.identity()
    if kind != motion.category or kind not in load_manifest("mogaze").object_extents or mogaze.is_furniture(name):
        return -motion.half_extents, motion.half_extents, upright
    low, high = np.array(load_manifest("mogaze").object_extents[kind]).T
    return low, high, _UPRIGHT_FROM_Z_UP if kind in _Z_UP_KINDS else upright


def _carries(performance: Performance, names: dict[str, str], n_frames: int) -> list[tuple[int, int, str]]:
    """Return first and last frame of every movement, in order; an object never put down moves until the end."""
    carries = []
    held = dict[str, int]()
    for event in sorted(events(performance), key=lambda event: event.event_time):
        frame = round((event.event_time - float(performance.times[0])) * mogaze.RATE)
        if event.expected == "not_an_event":
            continue
        if event.action == "pick":
            held[event.object_id] = frame
        elif event.object_id in held:
            carries.append((held.pop(event.object_id), frame, names[event.object_id]))
    carries += [(frame, n_frames - 1, names[object_id]) for object_id, frame in held.items()]
    return sorted(carries)


_GAZE_COLUMNS = 7
_COLOUR = "1 0.5 0.5 0.5"
_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
_FACES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


def write(readings: mogaze.MogazeReadings, root: Path) -> None:
    """Write the four files of one recording below the dataset's folder.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    root.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def new_file(part: str) -> Iterator[h5py.File]:
        path = root / f"{readings.recording_id}_{part}.hdf5"
        with atomic_path(path) as temporary, h5py.File(temporary, "w", track_order=False) as file:
            yield file

    human, objects, gaze, segments = mogaze.PARTS
    with new_file(human) as file:
        entry = file.create_dataset(mogaze.HUMAN_DATASET, data=readings.state)
        entry.attrs[mogaze.COLUMNS_ATTRIBUTE] = np.array(STATE_COLUMNS, dtype="S")
        entry.attrs[mogaze.START_ATTRIBUTE] = 0
        entry.attrs[mogaze.FIXED_KEYS_ATTRIBUTE] = np.array(list(readings.fixed), dtype="S")
        entry.attrs[mogaze.FIXED_VALUES_ATTRIBUTE] = np.array(list(readings.fixed.values()))
        entry.attrs[mogaze.PARTICIPANT_ATTRIBUTE] = readings.participant_id
    with new_file(objects) as file:
        bodies = file.create_group(mogaze.OBJECT_GROUP)
        for body in readings.bodies:
            bodies.create_dataset(f"body {body.body_id}", data=np.hstack([body.position, body.rotation]))
    with new_file(gaze) as file:
        # One row more than the other files have, as in the release; columns of unknown meaning are zero.
        rows = np.zeros((len(readings.gaze_points) + 1, _GAZE_COLUMNS))
        rows[:-1, mogaze.GAZE_POINT] = readings.gaze_points
        rows[:-1, -1] = readings.gaze_confidence
        rows[-1] = rows[-2]
        entry = file.create_dataset(mogaze.GAZE_DATASET, data=rows)
        entry.attrs[mogaze.CALIBRATION_ATTRIBUTE] = readings.calibration
    with new_file(segments) as file:
        kinds = np.dtype([("start", "<i8"), ("end", "<i8"), ("label", f"S{mogaze.LABEL_LENGTH}")])
        named = [(segment.start, segment.end, segment.label.encode()) for segment in readings.segments]
        entry = file.create_dataset(mogaze.SEGMENT_DATASET, data=np.array(named, dtype=kinds))
        labels = dict.fromkeys([mogaze.NULL_LABEL, *(segment.label for segment in readings.segments)])
        entry.attrs[mogaze.LABELS_ATTRIBUTE] = np.array(list(labels), dtype="S")


def box_mesh(low: Size, high: Size) -> str:
    """Return a box of twelve triangles as Wavefront OBJ; its numbers survive the text bit for bit."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.where(_CORNERS, high, low).tolist()]
    return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in _FACES), ""])


def _write_below(readings: mogaze.MogazeReadings, root: Path) -> None:
    """Write four files, and the recording's share of the scene: name, mesh and box of each body, by id."""
    write(readings, root)
    extents = load_manifest("mogaze").object_extents
    share = {}
    for body in readings.bodies:
        kind = mogaze.kind_of_body(body.name)
        shared = kind in extents and np.array_equal(np.transpose(extents[kind]), [body.box_min, body.box_max])
        mesh = f"{kind}.obj" if shared else f"body_{body.body_id}.obj"
        box = [body.box_min.tolist(), body.box_max.tolist()]
        share[str(body.body_id)] = [body.name, "" if body.name == mogaze.GOGGLES else mesh, box]
    write_json(root / SHARED_PARTS / f"{readings.recording_id}.json", share)


def _finish(root: Path) -> None:
    """Write ``scene.xml`` of all recordings, and one box mesh for each shape that it names."""
    entries: dict[int, Any] = {}
    for part in sorted((root / SHARED_PARTS).glob("*.json")):
        entries |= {int(key): entry for key, entry in json.loads(part.read_bytes()).items()}
    lines = ['<?xml version="1.0"?>', "<scene>"]
    for key, (name, mesh, (low, high)) in sorted(entries.items()):
        lines.append(f'  <body id="{key}" name={quoteattr(name)}>')
        if mesh:
            write_text(root / mogaze.MESH_FOLDER / mesh, box_mesh(np.array(low), np.array(high)))
            lines.append(f"    <meshfile src={quoteattr(f'mogaze/{mogaze.MESH_FOLDER}/{mesh}')}/>")
        lines += [f"    <color>{_COLOUR}</color>", "  </body>"]
    write_text(root / mogaze.SCENE_FILE, "\n".join([*lines, "</scene>", ""]))


# The clock starts at 0 with the first frame, and objects keep their ids.
LAYOUT = Layout("mogaze", sense, recording_from_mogaze, _write_below, events, lambda _: 0.0, str, GAZE_BIAS, _finish)
