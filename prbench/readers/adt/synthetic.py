"""What the sensors of Aria Digital Twin see of synthetic people, and its native files (docs/specification/adt.md).

Sensors: docs/specification/synthetic-recordings.md#sensors, rows "adt". The optical suit has 51 joints and 57 markers;
they follow from the 22 joints and the finger bases of a performance. Readings are rounded to the resolution of the
files (micrometres, microradians, 1e-9 for quaternions), so that files and memory hold the same numbers.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_folder, write_bytes, write_json
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import interpolate, slerp
from prbench.protocol.manifests import read_toml
from prbench.readers.adt import format as adt
from prbench.readers.adt.to_recording import prepared_trajectory, recording_from_adt
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps import synthetic as aria
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.synthetic import sense_egoallo, write_outputs, write_smplh_model
from prbench.synthetic.layouts import Layout
from prbench.synthetic.people.kinematics import UP, unit, wobble
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Sensing, Switches, device_start_us, fixation_depth, tracked, untracked

Joints = Float[np.ndarray, "n 22 3"]
SuitJoints = Float[np.ndarray, "n 51 3"]
FingerBases = Float[np.ndarray, "n 2 3"]

# The suit: its joints, straight fingers, and the bones that bear markers; the file explains its tables.
_SUIT = read_toml("prbench.readers.adt", "synthetic_suit.toml", dict[str, dict[str, Any]])
_FINGER_JOINTS = [name for name in adt.JOINT_NAMES if name[1:-1] in _SUIT["fingers"]]
# Maps each native joint to the joint at the other end of its bone; parents stand before their children.
_PARENTS = {name: row["parent"] for name, row in _SUIT["joints"].items() if "parent" in row} | {
    name: f"{name[0]}Hand" if name[-1] == "1" else f"{name[:-1]}{int(name[-1]) - 1}" for name in _FINGER_JOINTS
}
_MARKERS_ALONG_BONE = (0.2, 0.5, 0.8)
RATE = 30.0  # Glasses, gaze and objects, Hz.
_BODY_RATE = 120.0
GLASSES_SIZE = "DVT-L"
_POSE_NOISE = 0.5e-3  # m
_POSE_TURN = np.deg2rad(0.05)
_POSE_LOSS = 0.01
# The third differences of the release's own sample have an r.m.s. of 0.2 mm at 120 Hz: white noise is at most 0.05 mm.
_BODY_NOISE = 0.05e-3
_BODY_WOBBLE = 3e-3
_BODY_WOBBLE_HZ = (0.05, 0.3)
_BODY_LOSS = 1e-4  # share of the frames at the origin or with a joint thrown off
_MARKER_LOSS = 0.01  # share of the markers that are occluded
_THROW = 0.5  # m
_OBJECT_NOISE = 0.3e-3
_OBJECT_TURN = np.deg2rad(0.1)
_ROOM_HALF_EXTENTS = (6.0, 1.5, 6.0)
_METRES = 6  # decimals
_QUATERNION = 9


def sense(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> adt.AdtReadings:
    """Return what the sensors of an ADT recording say about a performance.

    Args:
        performance: The truth; any rate, usually 120 Hz.
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
        switches: Which errors are on; all if None.
    """
    sensing = Sensing(performance, noise, switches or Switches())
    times = sensing.times(RATE)
    pose_us = device_start_us(performance) + np.rint((times - performance.times[0]) * 1e6).astype(np.int64)
    position, rotation = aria.device_poses(sensing, times, GLASSES_SIZE)
    rng = sensing.generator("pose-noise")
    scale = sensing.strength("pose_noise")
    offset = rng.normal(0.0, _POSE_NOISE, (len(times), 3)) * scale
    turned = rotation * Rotation.from_rotvec(rng.normal(0.0, _POSE_TURN, (len(times), 3)) * scale)
    lost = sensing.generator("pose-losses").random(len(times)) < _POSE_LOSS * sensing.strength("pose_losses")
    quality = np.clip(1.0 - np.linalg.norm(offset, axis=1) / 5e-3, 0.2, 1.0)
    people = [(performance, performance.person.participant_id)]
    people += [(other, other.participant_id) for other in performance.other_people]
    concurrent = f"{performance.recording_id}-other" if performance.other_people else ""
    names = (performance.recording_id, _glasses_serial(performance), concurrent)
    quaternion = np.round(turned.as_quat(canonical=True, scalar_first=True), _QUATERNION)
    quality = np.round(np.where(lost, 0.0, quality), _METRES)
    glasses = mps.AriaTrajectory(pose_us, np.round(position + offset, _METRES), quaternion, quality)
    # The file's depth is 0, "unknown", between fixations.
    gaze = aria.gaze_rows(sensing, times, pose_us - adt.GAZE_BEFORE_POSE_US, fixation_depth(sensing, times, 0.0))
    objects = _sense_objects(sensing, times, pose_us * 1000 + adt.OBJECT_AFTER_POSE_NS)
    skeletons = []
    for number, (body, person_id) in enumerate(people):
        skeletons.append(_sense_suit(sensing, body.joints, body.finger_bases, person_id, number))
    return adt.AdtReadings(*names, None, None, glasses, gaze, objects, tuple(skeletons))


def _glasses_serial(performance: Performance, other: int = 0) -> str:
    """Return a synthetic serial of the wearer's glasses, or of those of another person in the scene."""
    return f"SYNTH{performance.index:05d}M{other:02d}"


def _sense_objects(
    sensing: Sensing, times: Float[np.ndarray, " n"], time_ns: Int[np.ndarray, " n"]
) -> tuple[adt.AdtObject, ...]:
    performance = sensing.performance
    scale = sensing.strength("object_noise")
    # The real dataset has the room itself as an object, which readers must leave out.
    half = np.array(_ROOM_HALF_EXTENTS)
    names = (adt.SCENE_BOX_ID, "ApartmentEnv", "ApartmentEnv", "shelter")
    pose = (np.array([adt.STATIC_TIME]), np.array([[0.0, half[1] - 0.1, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]]))
    objects = [adt.AdtObject(*names, False, -half, half, *pose)]
    for motion in performance.objects:
        seen = ~untracked(performance, motion, times) if motion.movable else np.ones(1, dtype=bool)
        query = times if motion.movable else times[:1]
        # The poses of an object's own frame, whose origin is the middle of the box's base.
        track = performance.times[: len(motion.position)]
        rotation = Rotation.from_quat(slerp(track, motion.rotation, query), scalar_first=True)
        centre = interpolate(track, motion.position, query)
        position = centre - rotation.apply((0.0, motion.half_extents[1], 0.0))
        if motion.movable:
            size = (_OBJECT_NOISE, _OBJECT_TURN)
            position, rotation = tracked(sensing, motion.object_id, position, rotation, size=size, scale=scale)
        quaternion = rotation.as_quat(canonical=True, scalar_first=True)
        height = 2 * motion.half_extents[1]
        x, _, z = motion.half_extents
        category = "door" if motion.hinged else motion.category
        names = (native_object_id(motion.object_id), motion.name, re.sub(r"_\d+$", "", motion.name), category)
        box = (np.round(np.array([-x, 0.0, -z]), _METRES), np.round(np.array([x, height, z]), _METRES))
        stamps = time_ns[seen] if motion.movable else np.array([adt.STATIC_TIME])
        pose = (stamps, np.round(position, _METRES)[seen], np.round(quaternion, _QUATERNION)[seen])
        objects.append(adt.AdtObject(*names, motion.movable, *box, *pose))
    return tuple(sorted(objects, key=lambda entry: entry.object_id))


def native_object_id(object_id: str) -> int:
    """Return the id under which the native files know an object: 16 digits, the given ones where it has that many."""
    if re.fullmatch(r"[1-9]\d{14,15}", object_id):
        return int(object_id)
    return 10**15 + int.from_bytes(hashlib.sha256(object_id.encode()).digest()[:8], "big") % (8 * 10**15)


def _sense_suit(
    sensing: Sensing, joints: Joints, finger_bases: FingerBases, participant_id: str, number: int
) -> adt.AdtSkeleton:
    performance = sensing.performance
    times = sensing.times(_BODY_RATE)
    native = interpolate(performance.times, suit_joints(joints, finger_bases), times)
    # How far each segment of the suit is shifted at every frame, metres.
    segments = len(np.unique(suit_segments()))
    rng = sensing.generator(f"body-noise-{number}")
    shift = rng.normal(0.0, _BODY_NOISE, (len(times), segments, 3)) * sensing.strength("body_noise")
    if wandering := sensing.strength("body_wobble"):
        rng = sensing.generator(f"body-wobble-{number}")
        slow = [wobble(times, _BODY_WOBBLE, *_BODY_WOBBLE_HZ, rng) for _ in range(3 * segments)]
        shift += np.stack(slow, axis=1).reshape(shift.shape) * wandering
    native = with_rigid_bones(native, shift)
    # Three markers along each of 19 bones.
    bones = [[adt.JOINT_NAMES.index(name) for name in bone] for bone in _SUIT["markers"]["bones"]]
    first, second = np.array(bones).T
    share = np.array(_MARKERS_ALONG_BONE)[:, None]
    points = native[:, first, None] * (1 - share) + native[:, second, None] * share
    markers = points.reshape(len(native), adt.N_MARKERS, 3)
    scale = sensing.strength("body_losses")
    rng = sensing.generator(f"body-losses-{number}")
    bad = np.flatnonzero(rng.random(len(times)) < _BODY_LOSS * scale)
    native[bad, rng.integers(adt.N_NATIVE_JOINTS, size=len(times))[bad]] += (0.0, _THROW, 0.0)
    native[bad[::2]] = 0.0  # every other bad frame is lost as a whole: the suit writes zeros
    markers[rng.random(markers.shape[:2]) < _MARKER_LOSS * scale] = 0.0
    time_ns = device_start_us(performance) * 1000 + np.rint((times - performance.times[0]) * 1e9).astype(np.int64)
    names = (f"Skeleton_{participant_id}", native_object_id(f"skeleton {participant_id}"))
    points = (np.round(native, _METRES), np.round(markers, _METRES))
    return adt.AdtSkeleton(*names, _glasses_serial(performance, number), time_ns, *points)


def suit_joints(joints: Joints, finger_bases: FingerBases) -> SuitJoints:
    """Return the 51 native joints: 21 of the body as they are, and straight fingers.

    Args:
        joints: The 22 joints, metres; spine2 has no native joint, the reader takes it between spine1 and spine3.
        finger_bases: Middle-finger bases, left and right.
    """
    native = np.zeros((len(joints), adt.N_NATIVE_JOINTS, 3))
    for name, row in _SUIT["joints"].items():
        native[:, adt.JOINT_NAMES.index(name)] = joints[:, Joint[row["joint"].upper()]]
    for side, letter in enumerate("LR"):
        elbow, wrist = (joints[:, joint + side] for joint in (Joint.LEFT_ELBOW, Joint.LEFT_WRIST))
        shoulder = joints[:, Joint.LEFT_SHOULDER + side]
        base = finger_bases[:, side]
        along = unit(base - wrist)
        # The normal of the arm's plane is the palm's side axis; a straight arm has none, any steady one will do.
        plane = np.cross(wrist - elbow, elbow - shoulder)
        is_bent = np.linalg.norm(plane, axis=-1, keepdims=True) > 1e-4
        aside = unit(np.cross(np.where(is_bent, plane, UP), along))
        for finger, (beside, places) in _SUIT["fingers"].items():
            for number, place in enumerate(places, start=1):
                native[:, adt.JOINT_NAMES.index(f"{letter}{finger}{number}")] = base + beside * aside + place * along
    return native


def suit_segments() -> Int[np.ndarray, "51"]:
    """Return which joints the suit shifts together: pelvis, chest and hands are rigid, every other joint is alone."""
    names = adt.JOINT_NAMES
    first = {name: row.get("rigid_with", name) for name, row in _SUIT["joints"].items()}
    first |= {name: f"{name[0]}Hand" for name in _FINGER_JOINTS}
    return np.unique([names.index(first.get(name, name)) for name in names], return_inverse=True)[1]


def with_rigid_bones(joints: SuitJoints, shifts: Float[np.ndarray, "n segments 3"]) -> SuitJoints:
    """Move the segments of a suit without changing the length of a bone, as its solver does.

    The bones of the release's own sample keep their lengths to a millionth (docs/specification/adt.md#joints).

    Args:
        joints: True joints, metres.
        shifts: Wanted shift of each segment (see :func:`suit_segments`), metres.

    Returns:
        Joints that lie in the wanted direction from their parents; a shift along a bone is passed on by its parent.
    """
    segments = suit_segments()
    moved = joints + shifts[:, segments]
    for name, parent_name in _PARENTS.items():
        child = adt.JOINT_NAMES.index(name)
        parent = adt.JOINT_NAMES.index(parent_name)
        bone = joints[:, child] - joints[:, parent]
        if segments[child] != segments[parent]:
            wanted = moved[:, child] - moved[:, parent]
            bone = wanted * np.sqrt((bone * bone).sum(axis=1) / (wanted * wanted).sum(axis=1))[:, None]
        moved[:, child] = moved[:, parent] + bone
    return moved


_GRAPH_UID = "00000000-0000-0000-0000-000000000000"
_GRAVITY = (0.0, -9.81, 0.0)
_CREATED = "01/01/2000-00:00:00"


def estimated_outputs(
    performance: Performance, readings: adt.AdtReadings, *, noise: float = 1.0, switches: Switches | None = None
) -> tuple[ego.EgoAlloOutput, ...]:
    """Return what EgoAllo would make of the glasses of one recording, in the scene turned to Z up."""
    return sense_egoallo(
        performance,
        prepared_trajectory(readings.glasses),
        noise=noise,
        switches=switches,
        start_us=device_start_us(performance),
        size=GLASSES_SIZE,
        native_from_world=adt.Z_UP_FROM_SCENE,
    )


def write(readings: adt.AdtReadings, folder: Path) -> None:
    """Write one recording in layout v2.0: one flat folder, complete or not at all.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    with atomic_folder(folder) as target:
        count = len(readings.skeletons)
        metadata = {"gt_creation_time": _CREATED, "scene": "Synthetic", "is_multi_person": count > 1}
        metadata |= {"num_skeletons": count, "timecode_enabled": 0, "gt_time_domain": adt.TIME_DOMAIN}
        metadata |= {"dataset_name": "ADT_2023", "serial": readings.serial}
        metadata |= {"concurrent_sequence": readings.concurrent, "dataset_version": "2.0"}
        write_json(target / adt.METADATA_FILE, metadata)
        objects = readings.objects
        instances = []
        for each in objects:
            told = (each.object_id, each.name, each.prototype, each.category)
            instances.append(_instance(*told, dynamic=each.dynamic, human=False))
        for one in readings.skeletons:
            instances.append(_instance(one.skeleton_id, one.name, "Skeleton", "person", dynamic=True, human=True))
        write_json(target / adt.INSTANCES_FILE, {str(entry["instance_id"]): entry for entry in instances})
        still = np.zeros((len(readings.glasses.time_us), 6))
        trajectory = mps.trajectory_columns(readings.glasses, _GRAPH_UID, _GRAVITY, still)
        aria.write_csv(target / adt.TRAJECTORY_FILE, trajectory)
        gaze = readings.gaze
        ranges = (gaze.yaw_range[:, 0], gaze.pitch_range[:, 0], gaze.yaw_range[:, 1], gaze.pitch_range[:, 1])
        names = (mps.YAW_RANGE[0], mps.PITCH_RANGE[0], mps.YAW_RANGE[1], mps.PITCH_RANGE[1])
        columns: dict[str, object] = {mps.TIME_COLUMN: gaze.time_us, mps.YAW: gaze.yaw, mps.PITCH: gaze.pitch}
        columns |= {mps.DEPTH: gaze.depth} | dict(zip(names, ranges, strict=True))
        aria.write_csv(target / adt.GAZE_FILE, columns)
        columns = {mps.OBJECT_ID: np.array([entry.object_id for entry in objects])}
        columns[mps.OBJECT_TIME] = np.full(len(objects), adt.STATIC_TIME)
        for axis in range(3):
            columns[adt.BOX_MIN[axis]] = np.array([entry.box_min[axis] for entry in objects])
            columns[adt.BOX_MAX[axis]] = np.array([entry.box_max[axis] for entry in objects])
        aria.write_csv(target / adt.BOXES_FILE, columns)
        aria.write_csv(target / adt.OBJECTS_FILE, aria.pose_columns({entry.object_id: entry for entry in objects}))
        people = [
            {"AssociatedDeviceSerial": person.serial, "SkeletonId": person.skeleton_id, "SkeletonName": person.name}
            for person in readings.skeletons
        ]
        write_json(target / adt.ASSOCIATION_FILE, {"SkeletonMetadata": people})
        for person in readings.skeletons:
            markers = np.zeros((len(person.joints), adt.N_MARKERS, 3)) if person.markers is None else person.markers
            rows = zip(markers.tolist(), person.joints.tolist(), person.time_ns.tolist(), strict=True)
            frames = [{"markers": markers, "joints": joints, "timestamp_ns": time} for markers, joints, time in rows]
            content = {"dt_optitrack_minus_device_ns": {person.serial: 0}, "frames": frames}
            write_bytes(target / f"{person.name}.json", msgspec.json.encode(content))


def _instance(uid: int, name: str, prototype: str, category: str, *, dynamic: bool, human: bool) -> dict[str, object]:
    names = {"instance_id": uid, "instance_name": name, "prototype_name": prototype, "category": category}
    motion = {"category_uid": 0, "motion_type": "dynamic" if dynamic else "static"}
    kind = {"instance_type": "human" if human else "object", "rigidity": "deformable" if human else "rigid"}
    frame = {"up_vector": [0, 1, 0], "front_vector": [0, 0, 1]}
    return {**names, **motion, **kind, "rotational_symmetry": {"is_annotated": False}, "canonical_pose": frame}


def _write_estimates(performance: Performance, readings: adt.AdtReadings, root: Path, *, noise: float = 1.0) -> None:
    """Write bodies as EgoAllo estimates them from the glasses, and the body model that reading them needs."""
    outputs = estimated_outputs(performance, readings, noise=noise)
    write_outputs(outputs, root / ego.POSES_FOLDER / readings.recording_id / ego.OUTPUT_FOLDER)
    if not (root / ego.MODEL_FILE).is_file():
        write_smplh_model(root / ego.MODEL_FILE)


LAYOUT = Layout(
    dataset="adt",
    sense=sense,
    to_recording=recording_from_adt,
    write=lambda readings, root: write(readings, root / readings.recording_id),
    events=lambda performance: performance.events,
    clock_start=lambda performance: device_start_us(performance) / 1e6,
    object_id=lambda object_id: str(native_object_id(object_id)),
    gaze_bias=aria.GAZE_BIAS["personalized"],
    write_estimates=_write_estimates,
)
