"""What HOT3D's sensors see of synthetic people, their hands in UmeTrack's form, and its native files.

Sources: docs/specification/synthetic-recordings.md#sensors, #native-layouts, and docs/specification/hot3d.md. The hand
has 80 vertices and 21 landmarks; in its frame x runs from the wrist along the middle finger, y out of the back of the
hand, z towards the thumb, and lengths are shares of the distance from the wrist to the base of the middle finger. The
truth's clock is that of the ground truth; the glasses' device clock drifts against it. Readings are rounded to the
resolution of the written files.
"""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_folder, read_json, write_bytes, write_json
from prbench.geometry.skeleton import Joint, z_up
from prbench.geometry.timelines import interpolate, slerp
from prbench.readers.aria_mps.format import OBJECT_TIME
from prbench.readers.aria_mps.synthetic import GAZE_BIAS, GAZE_RATE, pose_columns, sense_mps, write_csv, write_mps
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo import synthetic as egoallo
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import hands as umetrack
from prbench.readers.hot3d.format import HandModel
from prbench.readers.hot3d.to_recording import recording_from_hot3d
from prbench.synthetic.layouts import SHARED_PARTS, Layout
from prbench.synthetic.people.kinematics import unit
from prbench.synthetic.people.truth import seen_again
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors import Sensing, Switches, device_start_us, sensor_generator, tracked, untracked, within

Nanoseconds = Int[np.ndarray, " n"]
Times = Float[np.ndarray, " n"]

_BASES = ((0.20, -0.10, 0.18), (1.00, 0.00, 0.28), (1.00, 0.02, 0.00), (0.95, 0.00, -0.25), (0.86, -0.04, -0.48))
# From each joint of a finger to the next; the first two joints of a finger but the thumb share a place.
_STEPS = (
    ((0.32, 0.02, 0.16), (0.22, -0.16, 0.20), (0.22, -0.10, 0.20)),
    ((0.00, 0.00, 0.00), (0.42, -0.02, 0.00), (0.26, -0.02, 0.00)),
    ((0.00, 0.00, 0.00), (0.47, -0.02, -0.02), (0.30, -0.02, -0.02)),
    ((0.00, 0.00, 0.00), (0.44, -0.02, -0.06), (0.28, -0.02, -0.04)),
    ((0.00, 0.00, 0.00), (0.34, -0.02, -0.10), (0.22, -0.02, -0.06)),
)
_TIP = 0.26
_THUMB_AXES = ((0.8, 0.6, 0.0), (0.0, 0.6, 0.8), (0.6, 0.8, 0.0), (0.6, 0.8, 0.0))
# Spreading, then three times bending towards the palm.
_FINGER_AXES = ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, -1.0), (0.0, 0.0, -1.0))
_THICKNESS = 0.10
_PALM_ALONG = (0.08, 0.30, 0.52, 0.74, 0.94)
_PALM_ACROSS = (-0.35, 0.22)
_DECIMALS = 6  # of millimetres
# Bending of each finger joint of an empty and of a holding hand, radians.
_OPEN = 0.20
_CLOSED = 0.55
_SPREAD = 0.03  # Radians; never 0, at which the dataset's own toolkit divides by zero.
_ROOT = 0
_WRIST = 1
_FIRSTS = range(0, umetrack.N_ANGLES, umetrack.JOINTS_A_FINGER)  # First joint of each finger.


def synthetic_hand(length: float) -> HandModel:
    """Return the left hand of somebody whose middle finger begins ``length`` metres from the wrist."""
    fingers = [np.cumsum([base, *steps], axis=0) for base, steps in zip(_BASES, _STEPS, strict=True)]
    joints = np.concatenate([*fingers, np.zeros((2, 3))])
    bones = [first + step for first in range(0, 20, 4) for step in (1, 2, 3)]
    tips = np.array([joints[first + 3] + _TIP * unit(joints[first + 3] - joints[first + 2]) for first in _FIRSTS])
    one_hot = np.eye(umetrack.N_BONES)
    points = []
    weights = []
    for bone, joint in enumerate(bones, start=2):
        end = tips[(bone - 2) // 3] if (bone - 2) % 3 == 2 else joints[joint + 1]
        # The middle joint of three belongs to the base: a base phalanx is skinned to the wrist as well.
        share = 0.2 if (bone - 2) % 3 == 0 else 0.0
        # Four points around a bone, a fifth of the way along it.
        start = joints[joint]
        centre = start + 0.2 * (end - start)
        along = unit(end - start)
        aside = unit(np.cross(along, (0.0, 1.0, 0.0)))
        above = np.cross(aside, along)
        points.append(centre + _THICKNESS * np.array([aside, above, -aside, -above]))
        weights.append(np.tile(share * one_hot[_WRIST] + (1 - share) * one_hot[bone], (4, 1)))
    palm = np.array([(x, y, z) for x in _PALM_ALONG for z in _PALM_ACROSS for y in (-0.12, 0.12)])
    points.append(palm)
    weights.append(np.tile(0.2 * one_hot[_ROOT] + 0.8 * one_hot[_WRIST], (len(palm), 1)))
    vertices = np.concatenate(points)
    # Landmarks: the tips, wrist, two of the thumb, three of every other finger, palm; each fixed to one bone.
    others = [joints[first + step] for first in (4, 8, 12, 16) for step in (1, 2, 3)]
    landmarks = np.array([*tips, np.zeros(3), joints[2], joints[3], *others, (0.7, -0.12, 0.0)])
    fixed = [4, 7, 10, 13, 16, _WRIST, 2, 3]
    fixed += [bone for last in (7, 10, 13, 16) for bone in (_WRIST, last - 2, last - 1)]
    # A strip over each group of four vertices; nothing is computed from them.
    corners = np.arange(0, len(vertices), 4)[:, None]
    # Lengths in metres, as a reader computes them from rounded millimetres.
    unit_m = umetrack.METRES_A_UNIT
    shares = (vertices, joints, landmarks)
    placed, rest, marks = (np.round(each * length / unit_m, _DECIMALS) * unit_m for each in shares)
    axes = np.array([*_THUMB_AXES, *_FINGER_AXES * 4, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
    triangles = np.concatenate([corners + np.array(face) for face in ((0, 1, 2), (0, 2, 3))])
    return HandModel(placed, np.concatenate(weights), rest, axes, marks, one_hot[[*fixed, _WRIST]], triangles)


def wrist_rotation(segment: Rotation, side: int) -> Rotation:
    """Return UmeTrack's wrist rotation from a hand segment (y along the hand, x to the left at neutral).

    Args:
        segment: World from segment.
        side: 0 left, 1 right; a right hand's x axis points back along the hand, since posing mirrors it.
    """
    mirror = 1.0 if side == 0 else -1.0
    columns = np.array([[0.0, mirror, 0.0], [mirror, 0.0, 0.0], [0.0, 0.0, -1.0]])  # y, x, -z
    return segment * Rotation.from_matrix(columns)


def finger_angles(closed: Times) -> Float[np.ndarray, "n 22"]:
    """Return the joint angles of a hand between open (0) and closed around something (1), radians."""
    angles = np.zeros((len(closed), umetrack.N_JOINTS))
    bend = _OPEN + closed * (_CLOSED - _OPEN)
    for first in _FIRSTS:
        angles[:, first] = _SPREAD
        angles[:, first + 1 : first + 4] = bend[:, None]
    angles[:, 0:4] = 0.3 * bend[:, None]
    return angles


RATE = 30.0  # RGB frames, Hz; SLAM frames follow each after :data:`SLAM_DELAY`.
SLAM_DELAY = 91e-6  # Seconds.

_TIME_CODE_START = (3_600.0, 80_000.0)  # s
_LARGEST_DRIFT = 1e-6
_OBJECT_NOISE = (0.5e-3, np.deg2rad(0.1))  # m, rad
_GAP_SHARE = 0.03  # of the rows; s
_GAP_LENGTH = (0.05, 0.5)
_HAND_NOISE = 2e-3
_HAND_SIGHT = np.deg2rad(75.0)
_WRONG_START = 0.7  # s, m
_WRONG_BY = 0.25
_WRONG_EVERY = 5
_WRONG_FIRST = 1
_CLOSING = 0.3  # s
# Centre of the box in the object's frame, metres: origins of real models lie beside it, too.
_ORIGIN = np.array([0.004, -0.006, 0.0])
_METRES = 6  # decimals
_QUATERNION = 9
_ANGLE = 6


def sense(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> hot3d.Hot3dReadings:
    """Return what the sensors of a HOT3D recording say about a performance.

    Args:
        performance: The truth; any rate, usually 120 Hz.
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
        switches: Which errors are on; all if None.
    """
    sensing = Sensing(performance, noise, switches or Switches())
    since = frame_times(performance)
    time_ns = round(clock_start(performance) * 1e9) + np.rint(since * 1e9 * (1 + clock_drift(sensing))).astype(np.int64)
    start_us = device_start_us(performance)
    mps = sense_mps(performance, start_us=start_us, noise=noise, switches=switches, hands=False)
    outputs = egoallo.sense_egoallo(performance, mps.trajectory, noise=noise, switches=switches, start_us=start_us)
    times = performance.times[0] + since
    hands = tuple(_sense_hand(sensing, side, times, time_ns) for side in (0, 1))
    trajectory = mps.trajectory
    query = start_us + np.rint(since * 1e6).astype(np.int64)
    right = np.clip(np.searchsorted(trajectory.time_us, query), 1, len(trajectory.time_us) - 1)
    row = np.where(query - trajectory.time_us[right - 1] <= trajectory.time_us[right] - query, right - 1, right)
    hand_length = float(np.linalg.norm(performance.finger_bases[0, 0] - performance.joints[0, Joint.LEFT_WRIST]))
    # Flags of the RGB frames.
    rgb = time_ns[::2]
    good = np.ones(len(rgb), dtype=bool)
    masks: dict[hot3d.MaskName, hot3d.Mask] = {
        "headset_pose_available": (rgb, good),
        "object_pose_available": (rgb, good),
        "hand_pose_available": (rgb, np.isin(rgb, np.concatenate([hand.time_ns for hand in hands]))),
    }
    # True where a recording of a newer release, which says in which frames the hands are right.
    if sensing.performance.index % 2 == 0:
        passed = good if not _has_wrong_start(sensing) else rgb - rgb[0] >= round(_WRONG_START * 1e9)
        masks["qa_pass"] = rgb, passed
    identity = (performance.recording_id, performance.person.participant_id)
    headset = hot3d.PoseRows(time_ns, trajectory.position[row], trajectory.rotation[row])
    objects = _sense_objects(sensing, times, time_ns)
    body = body_from_outputs(outputs, egoallo.synthetic_smplh())
    model = synthetic_hand(hand_length)
    return hot3d.Hot3dReadings(*identity, headset, objects, hands, model, masks, mps, body, outputs)


def clock_start(performance: Performance) -> float:
    """Return the time of the ground truth's clock at the performance's first instant, whole microseconds, seconds."""
    return round(float(sensor_generator(performance, "time-code").uniform(*_TIME_CODE_START)), 6)


def clock_drift(sensing: Sensing) -> float:
    """Return how much faster the ground truth's clock runs than the glasses'."""
    drift = sensing.generator("clock-drift").uniform(-_LARGEST_DRIFT, _LARGEST_DRIFT)
    return float(drift * sensing.strength("clock_drift"))


def frame_times(performance: Performance) -> Times:
    """Return the seconds from the performance's first instant: every RGB frame and the SLAM frame after it."""
    rgb = np.arange(int((performance.duration - SLAM_DELAY + 1e-9) * RATE) + 1) / RATE
    return np.column_stack([rgb, rgb + SLAM_DELAY]).ravel()


def native_object_id(object_id: str) -> str:
    """Return the uid under which the native files know an object: 15 digits."""
    return str(10**14 + int.from_bytes(hashlib.sha256(object_id.encode()).digest()[:8], "big") % (9 * 10**14))


def _has_wrong_start(sensing: Sensing) -> bool:
    """Return True where the hands of the first 0.7 s are wrong, as in several real recordings."""
    return sensing.strength("hand_start") > 0 and sensing.performance.index % _WRONG_EVERY == _WRONG_FIRST


def _sense_objects(sensing: Sensing, times: Times, time_ns: Nanoseconds) -> tuple[hot3d.Hot3dObject, ...]:
    performance = sensing.performance
    scale = sensing.strength("object_noise")
    objects = []
    for motion in performance.objects:
        track = performance.times[: len(motion.position)]
        rotation = Rotation.from_quat(slerp(track, motion.rotation, times), scalar_first=True)
        position = interpolate(track, motion.position, times) - rotation.apply(_ORIGIN)
        position, rotation = tracked(sensing, motion.object_id, position, rotation, size=_OBJECT_NOISE, scale=scale)
        # Runs of missing rows.
        rng = sensing.generator(f"object-gaps-{motion.object_id}")
        count = rng.poisson(_GAP_SHARE * sensing.strength("object_gaps") * performance.duration / np.mean(_GAP_LENGTH))
        starts = rng.uniform(times[0], times[-1], count)
        gaps = within(times, np.column_stack([starts, starts + rng.uniform(*_GAP_LENGTH, count)]))
        seen = ~(untracked(performance, motion, times) | gaps)
        uid = native_object_id(motion.object_id)
        name = f"{motion.name}_{uid[-4:]}"  # the library finds uids by name, too
        rows = _native_rows(time_ns, position, rotation, seen)
        objects.append(hot3d.Hot3dObject(uid, name, rows, box_mesh(motion.half_extents)))
    return tuple(sorted(objects, key=lambda entry: entry.object_id))


def box_mesh(half_extents: Float[np.ndarray, "3"]) -> hot3d.Mesh:
    """Return a box as twelve triangles in the object's frame, metres, rounded to micrometres."""
    corners = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
    return np.round(corners * half_extents + _ORIGIN, _METRES), faces


def _sense_hand(sensing: Sensing, side: int, times: Times, time_ns: Nanoseconds) -> hot3d.HandRows:
    performance = sensing.performance
    joint = Joint.LEFT_WRIST + side
    wrist = interpolate(performance.times, performance.joints[:, joint], times)
    segment = Rotation.from_quat(slerp(performance.times, performance.rotations[:, joint], times), scalar_first=True)
    noise = sensing.generator(f"hand-noise-{side}").normal(0.0, _HAND_NOISE, wrist.shape)
    sensed = wrist + noise * sensing.strength("hand_noise")
    if _has_wrong_start(sensing):
        sensed[times < times[0] + _WRONG_START] += (0.0, _WRONG_BY, 0.0)
    seen = np.ones(len(times), dtype=bool)
    if sensing.strength("hand_losses"):
        local = sensing.head(times).inv().apply(wrist - sensing.eye(times))
        seen = np.arctan2(np.linalg.norm(local[:, :2], axis=1), local[:, 2]) <= _HAND_SIGHT
    rows = _native_rows(time_ns, sensed, wrist_rotation(segment, side), seen)
    held = np.any([motion.held_by == side for motion in performance.objects if len(motion.held_by) > 1], axis=0)
    # Fingers close and open within a window around the grasp, not in one frame.
    window = max(1, round(_CLOSING * performance.rate))
    closed = uniform_filter1d(np.broadcast_to(held, performance.times.shape).astype(float), window)
    angles = finger_angles(interpolate(performance.times, closed, times[seen]))
    return hot3d.HandRows(("left", "right")[side], rows.time_ns, rows.position, rows.rotation, np.round(angles, _ANGLE))


def _native_rows(
    time_ns: Nanoseconds, position: Float[np.ndarray, "n 3"], rotation: Rotation, seen: Bool[np.ndarray, " n"]
) -> hot3d.PoseRows:
    """Return those poses that were seen, in the native world, rounded."""
    turned = Rotation.from_matrix(egoallo.NATIVE_FROM_WORLD[:3, :3]) * rotation
    turns = turned.as_quat(canonical=True, scalar_first=True)
    return hot3d.PoseRows(time_ns[seen], np.round(z_up(position), _METRES)[seen], np.round(turns, _QUATERNION)[seen])


_HEADSET_UID = "100000000000001"
LIBRARY = hot3d.LIBRARY_FOLDERS[0]
# Files that a recording has and curation does not read; all true.
_OTHER_MASKS = ("good_exposure", "hand_visible", "object_visible")
_OF_AN_EVENT = ("sequence", "not_primed", "too_short", "minimum_movement")
_UNSET = 255.0  # Rows of the hand model's unused tables of joints.
_SCALE = 0.001  # the models of the release are in millimetres, scaled by their node
_QUARTER_TURN = (0.0, -np.sqrt(0.5), 0.0, np.sqrt(0.5))  # x y z w, about the vertical
_SHIFT = (0.0045, -0.0205, -0.0155)
_MAGIC = 0x46546C67
_JSON = 0x4E4F534A
_BINARY = 0x004E4942
_FLOAT = 5126
_SHORT = 5123
_TRIANGLES = 4


def write(readings: hot3d.Hot3dReadings, folder: Path) -> None:
    """Write the files of one recording: complete or not at all.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    with atomic_folder(folder) as target:
        available = {"mano_hand_pose_gt": False, "object_pose_gt": True, "umetrack_hand_pose_gt": True}
        metadata = {"gt_available_status": available, "headset": hot3d.ARIA}
        metadata |= {"participant_id": readings.participant_id, "recording_name": readings.recording_id}
        write_json(target / hot3d.METADATA_FILE, metadata)
        bodies = {entry.object_id: entry.rows for entry in readings.objects}
        write_csv(target / hot3d.OBJECTS_FILE, pose_columns(bodies))
        write_csv(target / hot3d.HEADSET_FILE, pose_columns({_HEADSET_UID: readings.headset}))
        # One line an instant, also where no hand is tracked.
        lines: dict[int, dict[str, object]] = {time: {} for time in readings.headset.time_ns.tolist()}
        for hand in readings.hands:
            columns = (hand.time_ns, hand.position, hand.rotation, hand.angles)
            for time, position, rotation, angles in zip(*(column.tolist() for column in columns), strict=True):
                pose = {"wrist_xform": {"t_xyz": position, "q_wxyz": rotation}, "joint_angles": angles}
                lines[time][hot3d.HAND_KEYS[hand.side]] = {**pose, "hand_confidence": 1.0}
        records = [{"timestamp_ns": time, "hand_poses": poses} for time, poses in lines.items()]
        write_bytes(target / hot3d.UMETRACK_FILE, b"".join(msgspec.json.encode(record) + b"\n" for record in records))
        if readings.hand_model is not None:
            write_json(target / hot3d.PROFILE_FILE, {"hand_model": profile(readings.hand_model)})
        rgb = readings.headset.time_ns[::2]
        truth = rgb, np.ones(len(rgb), dtype=bool)
        streams = (hot3d.RGB_STREAM, *hot3d.SLAM_STREAMS)
        for name, (times, good) in {**dict.fromkeys(_OTHER_MASKS, truth), **readings.masks}.items():
            # One row a camera and frame: the RGB frame, then both SLAM cameras' one after it.
            slam = times + round(SLAM_DELAY * 1e9)
            columns = {
                OBJECT_TIME: np.column_stack([times, slam, slam]).ravel(),
                hot3d.STREAM: np.tile(streams, len(times)),
                hot3d.MASK: np.repeat(np.where(good, "True", "False"), len(streams)),
            }
            write_csv(target / hot3d.MASK_FOLDER / f"mask_{name}.csv", columns)
        write_mps(readings.mps, target / hot3d.MPS_FOLDER)
        egoallo.write_outputs(readings.egoallo_outputs, target / ego.OUTPUT_FOLDER)


def write_library_part(readings: hot3d.Hot3dReadings, folder: Path) -> None:
    """Write names and models of one recording's objects."""
    objects = readings.objects
    names = {entry.object_id: _instance(entry.object_id, entry.name, hot3d.LIBRARY_OBJECT) for entry in objects}
    write_json(folder / hot3d.INSTANCES_FILE, names)
    for entry in objects:
        if entry.mesh is not None:
            content = glb_bytes(entry.mesh, name=entry.name, turned=int(entry.object_id) % 2 == 1)
            write_bytes(folder / f"{entry.object_id}.glb", content)


def _write_below(readings: hot3d.Hot3dReadings, root: Path) -> None:
    """Write one folder a recording; names and models of its objects wait for :func:`_finish`."""
    write(readings, root / readings.recording_id)
    write_library_part(readings, root / SHARED_PARTS / readings.recording_id)


def glb_bytes(mesh: hot3d.Mesh, *, name: str, turned: bool) -> bytes:
    """Return the file of one model: the node's transform brings its raw vertices into the object's frame.

    Args:
        mesh: Vertices and faces in the object's frame, metres; less than 65,536 vertices.
        name: Name of the node.
        turned: Whether the node turns and shifts what it holds, besides scaling it.
    """
    node: dict[str, object] = {"name": name, "mesh": 0, "scale": [_SCALE] * 3}
    raw, faces = mesh
    if turned:
        node |= {"rotation": list(_QUARTER_TURN), "translation": list(_SHIFT)}
        x, y, z = (raw - _SHIFT).T
        raw = np.column_stack([z, y, -x])  # the node turns it back: (x, y, z) becomes (-z, y, x)
    vertices = (raw / _SCALE).astype("<f4")  # glTF knows single precision only
    faces = faces.astype("<u2")
    content = vertices.tobytes() + faces.tobytes()
    description = {
        "asset": {"version": "2.0", "generator": "prbench"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": _TRIANGLES}]}],
        "accessors": [
            {
                "type": "VEC3",
                "componentType": _FLOAT,
                "count": len(vertices),
                "bufferView": 0,
                "min": vertices.min(axis=0).tolist(),
                "max": vertices.max(axis=0).tolist(),
            },
            {"type": "SCALAR", "componentType": _SHORT, "count": faces.size, "bufferView": 1},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": vertices.nbytes},
            {"buffer": 0, "byteOffset": vertices.nbytes, "byteLength": faces.nbytes},
        ],
        "buffers": [{"byteLength": len(content)}],
    }
    text = json.dumps(description).encode()
    chunks = b""
    for kind, part, padding in ((_JSON, text, b" "), (_BINARY, content, b"\0")):
        part += padding * (-len(part) % 4)
        chunks += struct.pack("<II", len(part), kind) + part
    return struct.pack("<III", _MAGIC, 2, 12 + len(chunks)) + chunks


def _finish(root: Path) -> None:
    """Gather the parts of all recordings into the object library, and write the body model.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    instances: dict[str, object] = {_HEADSET_UID: _instance(_HEADSET_UID, "Aria", "headset")}
    library = root / LIBRARY
    library.mkdir(exist_ok=True)
    for part in sorted((root / SHARED_PARTS).iterdir()):
        names = read_json(part / hot3d.INSTANCES_FILE)
        assert isinstance(names, dict)  # written above
        instances |= names
        for model in sorted(part.glob("*.glb")):
            model.replace(library / model.name)
    write_json(library / hot3d.INSTANCES_FILE, instances)
    egoallo.write_smplh_model(root / ego.MODEL_FILE)


def profile(model: HandModel) -> dict[str, object]:
    """Return the hand model with the keys of ``umetrack_hand_user_profile.json``, lengths in millimetres."""
    n = umetrack.N_JOINTS
    assert model.landmarks is not None  # as invented
    assert model.landmark_weights is not None
    assert model.triangles is not None
    points = {"joint_rest_positions": model.joint_positions, "landmark_rest_positions": model.landmarks}
    points["mesh_vertices"] = model.vertices
    content = {
        "dense_bone_weights": model.weights.tolist(),
        "hand_scale": 1.0,
        "joint_limits": [[-np.pi, np.pi]] * n,
        "joint_parent": [_UNSET if joint % umetrack.JOINTS_A_FINGER == 0 else float(joint - 1) for joint in range(n)],
        "joint_rotation_axes": model.joint_axes.tolist(),
        "landmark_rest_bone_indices": [[int(bone)] * 3 for bone in model.landmark_weights.argmax(axis=1)],
        "landmark_rest_bone_weights": [[1.0, 0.0, 0.0]] * umetrack.N_LANDMARKS,
        "mesh_triangles": model.triangles.astype(float).tolist(),
        **dict.fromkeys(("joint_first_child", "joint_frame_index", "joint_next_sibling"), [_UNSET] * n),
        **{name: np.round(part / umetrack.METRES_A_UNIT, 6).tolist() for name, part in points.items()},
    }
    return dict(sorted(content.items()))


def _instance(uid: str, name: str, kind: str) -> dict[str, object]:
    named = {"instance_bop_id": "0", "instance_id": uid, "instance_name": name, "instance_type": kind}
    return {**named, "motion_type": "dynamic", "rigidity": "rigid"}


def _events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return all events; whether a prime is certain depends on the ten gaze samples a second."""
    return tuple(
        seen_again(event, performance, event.box_min, event.box_max, gaze_period=1.0 / GAZE_RATE)
        if event.expected in _OF_AN_EVENT
        else event
        for event in performance.events
    )


_GAZE_BIAS = GAZE_BIAS["personalized"]
LAYOUT = Layout(
    "hot3d", sense, recording_from_hot3d, _write_below, _events, clock_start, native_object_id, _GAZE_BIAS, _finish
)
