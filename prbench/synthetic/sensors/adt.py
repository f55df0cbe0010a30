"""The sensors of Aria Digital Twin (docs/specification/synthetic-recordings.md#sensors, rows "adt").

Readings are rounded to the resolution of the written files (micrometres, microradians, 1e-9 for quaternions), so that
files and memory hold the same numbers.
"""

from __future__ import annotations

import hashlib
import re

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.readers.adt import format as adt
from prbench.readers.aria_mps.format import device_from_cpf
from prbench.skeleton import invert_rigid
from prbench.synthetic.people.channels import wobble
from prbench.synthetic.performance import ObjectMotion, Performance
from prbench.synthetic.sensors.aria_mps import (
    GAZE_MARGIN,
    gaze_clock_us,
    gaze_measurements,
    lost_gaze,
)
from prbench.synthetic.sensors.errors import Switches, sensor_generator, strength
from prbench.synthetic.sensors.suit import suit_joints, suit_markers, suit_segments
from prbench.timelines import interpolate, slerp

RATE = 30.0
"""Glasses, gaze and objects, Hz."""
_BODY_RATE = 120.0
GLASSES_SIZE = "DVT-L"

_CLOCK_START = (100.0, 60_000.0)  # s, device time of the first frame
_POSE_NOISE = 0.5e-3
_POSE_TURN = np.deg2rad(0.05)
_POSE_LOSS = 0.01
_BODY_NOISE = 0.8e-3
_BODY_WOBBLE = 3e-3
_BODY_WOBBLE_HZ = (0.05, 0.3)
_BODY_LOSS = 1e-4  # share, share, m
_MARKER_LOSS = 0.01
_THROW = 0.5
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
    switches = switches or Switches()
    times = performance.times[0] + np.arange(int((performance.duration + 1e-9) * RATE) + 1) / RATE
    pose_us = clock_start_us(performance) + np.rint((times - performance.times[0]) * 1e6).astype(np.int64)
    return adt.AdtReadings(
        recording_id=performance.recording_id,
        serial=_glasses_serial(performance),
        concurrent=f"{performance.recording_id}-other" if performance.other_people else "",
        glasses_size=None,
        device_from_rgb=None,
        glasses=_sense_glasses(performance, times, pose_us, noise, switches),
        gaze=_sense_gaze(performance, times, pose_us, noise, switches),
        objects=_sense_objects(performance, times, pose_us * 1000 + adt.OBJECT_AFTER_POSE_NS, noise, switches),
        skeletons=_sense_people(performance, noise, switches),
    )


def clock_start_us(performance: Performance) -> int:
    """Return the device time of the performance's first instant, microseconds.

    Device seconds = performance seconds - ``performance.times[0]`` + this / 1e6: what turns the truth's times into
    those of the recording.
    """
    return round(sensor_generator(performance, "clock").uniform(*_CLOCK_START) * 1e6)


def _glasses_serial(performance: Performance, other: int = 0) -> str:
    """Return a synthetic serial of the wearer's glasses, or of those of another person in the scene."""
    return f"SYNTH{performance.index:05d}M{other:02d}"


def native_object_id(object_id: str) -> int:
    """Return the id under which the native files know an object: 16 digits, the given ones where it has that many."""
    if re.fullmatch(r"[1-9]\d{14,15}", object_id):
        return int(object_id)
    return 10**15 + int.from_bytes(hashlib.sha256(object_id.encode()).digest()[:8], "big") % (8 * 10**15)


def _sense_glasses(
    performance: Performance,
    times: Float[np.ndarray, " n"],
    time_us: Int[np.ndarray, " n"],
    noise: float,
    switches: Switches,
) -> adt.GlassesPoses:
    cpf = Rotation.from_quat(slerp(performance.times, performance.head_rotation, times), scalar_first=True)
    cpf_from_device = invert_rigid(device_from_cpf(GLASSES_SIZE))
    rotation = cpf * Rotation.from_matrix(cpf_from_device[:3, :3])
    position = interpolate(performance.times, performance.eye, times) + cpf.apply(cpf_from_device[:3, 3])
    rng = sensor_generator(performance, "pose-noise")
    scale = strength(switches.pose_noise, noise)
    offset = rng.normal(0.0, _POSE_NOISE, (len(times), 3)) * scale
    turned = rotation * Rotation.from_rotvec(rng.normal(0.0, _POSE_TURN, (len(times), 3)) * scale)
    lost = sensor_generator(performance, "pose-losses").random(len(times)) < _POSE_LOSS * strength(
        switches.pose_losses, noise
    )
    quality = np.clip(1.0 - np.linalg.norm(offset, axis=1) / 5e-3, 0.2, 1.0)
    return adt.GlassesPoses(
        time_us,
        np.round(position + offset, _METRES),
        np.round(turned.as_quat(canonical=True, scalar_first=True), _QUATERNION),
        np.round(np.where(lost, 0.0, quality), _METRES),
    )


def _sense_gaze(
    performance: Performance,
    times: Float[np.ndarray, " n"],
    pose_us: Int[np.ndarray, " n"],
    noise: float,
    switches: Switches,
) -> adt.GazeAngles:
    angles = gaze_measurements(performance, times, noise=noise, switches=switches)
    lost = lost_gaze(performance, len(times), noise=noise, switches=switches)
    shift = gaze_clock_us(performance, len(times), noise=noise, switches=switches)
    time_us = pose_us - adt.GAZE_BEFORE_POSE_US + shift
    kept = ~lost
    yaw, pitch = np.round(angles[kept], _METRES).T
    margin = np.array([-GAZE_MARGIN, GAZE_MARGIN])
    return adt.GazeAngles(
        time_us[kept],
        yaw,
        pitch,
        np.round(_gaze_depth(performance, times), _METRES)[kept],
        np.round(yaw[:, None] + margin, _METRES),
        np.round(pitch[:, None] + margin, _METRES),
    )


def _gaze_depth(performance: Performance, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the distance from the eyes to the point fixated; 0, the file's "unknown", between fixations."""
    depth = np.zeros(len(times))
    eye = interpolate(performance.times, performance.eye, times)
    for look in performance.fixations:
        rows = slice(*np.searchsorted(times, (look.start, look.end)))
        depth[rows] = np.linalg.norm(look.target - eye[rows], axis=1)
    return depth


def _sense_objects(
    performance: Performance,
    times: Float[np.ndarray, " n"],
    time_ns: Int[np.ndarray, " n"],
    noise: float,
    switches: Switches,
) -> tuple[adt.AdtObject, ...]:
    scale = strength(switches.object_noise, noise)
    objects = [_room_object()]
    for motion in performance.objects:
        seen = ~_untracked(performance, motion, times) if motion.movable else np.ones(1, dtype=bool)
        query = times if motion.movable else times[:1]
        position, rotation = _object_poses(performance, motion, query)
        if motion.movable:
            rng = sensor_generator(performance, f"object-noise-{motion.object_id}")
            position = position + rng.normal(0.0, _OBJECT_NOISE, position.shape) * scale
            rotation = rotation * Rotation.from_rotvec(rng.normal(0.0, _OBJECT_TURN, position.shape) * scale)
        quaternion = rotation.as_quat(canonical=True, scalar_first=True)
        height = 2 * motion.half_extents[1]
        x, _, z = motion.half_extents
        objects.append(
            adt.AdtObject(
                object_id=native_object_id(motion.object_id),
                name=motion.name,
                prototype=re.sub(r"_\d+$", "", motion.name),
                category="door" if motion.hinged else motion.category,
                dynamic=motion.movable,
                box_min=np.round(np.array([-x, 0.0, -z]), _METRES),
                box_max=np.round(np.array([x, height, z]), _METRES),
                time_ns=time_ns[seen] if motion.movable else np.array([adt.STATIC_TIME]),
                position=np.round(position, _METRES)[seen],
                rotation=np.round(quaternion, _QUATERNION)[seen],
            )
        )
    return tuple(sorted(objects, key=lambda entry: entry.object_id))


def _object_poses(
    performance: Performance, motion: ObjectMotion, query: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Rotation]:
    """Return the poses of an object's own frame, whose origin is the middle of the box's base."""
    track = performance.times[: len(motion.position)]
    rotation = Rotation.from_quat(slerp(track, motion.rotation, query), scalar_first=True)
    centre = interpolate(track, motion.position, query)
    return centre - rotation.apply((0.0, motion.half_extents[1], 0.0)), rotation


def _untracked(
    performance: Performance, motion: ObjectMotion, times: Float[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return the instants of ``lost`` events, at which nobody sees the object."""
    spans = [event.lost_span for event in performance.events if event.object_id == motion.object_id and event.lost_span]
    hidden = [(times >= start) & (times <= end) for start, end in spans]
    return np.any(hidden, axis=0) if hidden else np.zeros(len(times), dtype=bool)


def _room_object() -> adt.AdtObject:
    """Return the room itself as an object, as the real dataset has it; readers must leave it out."""
    half = np.array(_ROOM_HALF_EXTENTS)
    return adt.AdtObject(
        object_id=adt.SCENE_BOX_ID,
        name="ApartmentEnv",
        prototype="ApartmentEnv",
        category="shelter",
        dynamic=False,
        box_min=-half,
        box_max=half,
        time_ns=np.array([adt.STATIC_TIME]),
        position=np.array([[0.0, half[1] - 0.1, 0.0]]),
        rotation=np.array([[1.0, 0.0, 0.0, 0.0]]),
    )


def _sense_people(performance: Performance, noise: float, switches: Switches) -> tuple[adt.AdtSkeleton, ...]:
    wearer = _sense_suit(
        performance, performance.joints, performance.finger_bases, performance.person.participant_id, 0, noise, switches
    )
    others = [
        _sense_suit(performance, person.joints, person.finger_bases, person.participant_id, number, noise, switches)
        for number, person in enumerate(performance.other_people, start=1)
    ]
    return wearer, *others


def _sense_suit(
    performance: Performance,
    joints: Float[np.ndarray, "n 22 3"],
    finger_bases: Float[np.ndarray, "n 2 3"],
    participant_id: str,
    number: int,
    noise: float,
    switches: Switches,
) -> adt.AdtSkeleton:
    times = performance.times[0] + np.arange(int((performance.duration + 1e-9) * _BODY_RATE) + 1) / _BODY_RATE
    native = interpolate(performance.times, suit_joints(joints, finger_bases), times)
    native += _suit_noise(performance, times, number, noise, switches)
    markers = suit_markers(native)
    scale = strength(switches.body_losses, noise)
    rng = sensor_generator(performance, f"body-losses-{number}")
    bad = np.flatnonzero(rng.random(len(times)) < _BODY_LOSS * scale)
    thrown = rng.integers(adt.N_NATIVE_JOINTS, size=len(times))[bad]
    native[bad, thrown] += (0.0, _THROW, 0.0)
    native[bad[::2]] = 0.0
    markers[rng.random(markers.shape[:2]) < _MARKER_LOSS * scale] = 0.0
    since_start = np.rint((times - performance.times[0]) * 1e9).astype(np.int64)
    return adt.AdtSkeleton(
        name=f"Skeleton_{participant_id}",
        skeleton_id=native_object_id(f"skeleton {participant_id}"),
        serial=_glasses_serial(performance, number),
        time_ns=clock_start_us(performance) * 1000 + since_start,
        joints=np.round(native, _METRES),
        markers=np.round(markers, _METRES),
    )


def _suit_noise(
    performance: Performance, times: Float[np.ndarray, " n"], number: int, noise: float, switches: Switches
) -> Float[np.ndarray, "n 51 3"]:
    rng = sensor_generator(performance, f"body-noise-{number}")
    shift = rng.normal(0.0, _BODY_NOISE, (len(times), adt.N_NATIVE_JOINTS, 3)) * strength(switches.body_noise, noise)
    scale = strength(switches.body_wobble, noise)
    if scale == 0:
        return shift
    rng = sensor_generator(performance, f"body-wobble-{number}")
    segments = suit_segments()
    slow = [wobble(times, _BODY_WOBBLE, *_BODY_WOBBLE_HZ, rng) for _ in range(3 * (segments.max() + 1))]
    return shift + np.stack(slow, axis=1).reshape(len(times), -1, 3)[:, segments] * scale
