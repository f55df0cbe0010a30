"""The sensors of HOT3D.

Sources: docs/specification/synthetic-recordings.md#sensors and
docs/specification/synthetic-recordings.md#native-layouts.

Readings are rounded to the resolution of the written files, so that files and memory hold the same numbers. The truth's
clock is that of the ground truth; the glasses' device clock drifts against it.
"""

from __future__ import annotations

import hashlib

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from prbench.axes import z_up
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.readers.hot3d import format as hot3d
from prbench.skeleton import Joint
from prbench.synthetic.egoallo import NATIVE_FROM_WORLD, sense_egoallo
from prbench.synthetic.performance import ObjectMotion, Performance
from prbench.synthetic.sensors.aria_mps import sense_mps
from prbench.synthetic.sensors.errors import Switches, sensor_generator, strength
from prbench.synthetic.sensors.hot3d_hand import finger_angles, synthetic_hand, wrist_rotation
from prbench.synthetic.sensors.smplh import synthetic_smplh
from prbench.timelines import interpolate, slerp

RATE = 30.0
"""RGB frames, Hz; SLAM frames follow each after :data:`SLAM_DELAY`."""
SLAM_DELAY = 91e-6
"""Seconds."""

_TIME_CODE_START = (3_600.0, 80_000.0)  # s
_DEVICE_START = (100.0, 60_000.0)
_LARGEST_DRIFT = 1e-6
_OBJECT_NOISE = 0.5e-3
_OBJECT_TURN = np.deg2rad(0.1)
_GAP_SHARE = 0.03  # of the rows; s
_GAP_LENGTH = (0.05, 0.5)
_HAND_NOISE = 2e-3
_HAND_SIGHT = np.deg2rad(75.0)
_WRONG_START = 0.7  # s, m
_WRONG_BY = 0.25
_WRONG_EVERY = 5
_WRONG_FIRST = 1
_CLOSING = 0.3  # s
_ORIGIN = np.array([0.004, -0.006, 0.0])
"""Centre of the box in the object's frame, metres: origins of real models lie beside it, too."""
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
    switches = switches or Switches()
    since = frame_times(performance)
    drift = clock_drift(performance, noise=noise, switches=switches)
    time_ns = round(clock_start(performance) * 1e9) + np.rint(since * 1e9 * (1 + drift)).astype(np.int64)
    start_us = round(sensor_generator(performance, "clock").uniform(*_DEVICE_START) * 1e6)
    mps = sense_mps(performance, start_us=start_us, noise=noise, switches=switches, hands=False)
    outputs = sense_egoallo(performance, mps.trajectory, noise=noise, switches=switches, start_us=start_us)
    times = performance.times[0] + since
    hands = tuple(_sense_hand(performance, side, times, time_ns, noise, switches) for side in (0, 1))
    trajectory = mps.trajectory
    row = _nearest(trajectory.time_us, start_us + np.rint(since * 1e6).astype(np.int64))
    hand_length = float(np.linalg.norm(performance.finger_bases[0, 0] - performance.joints[0, Joint.LEFT_WRIST]))
    return hot3d.Hot3dReadings(
        recording_id=performance.recording_id,
        participant_id=performance.person.participant_id,
        headset=hot3d.PoseRows(time_ns, trajectory.position[row], trajectory.rotation[row]),
        objects=_sense_objects(performance, times, time_ns, noise, switches),
        hands=hands,
        hand_model=synthetic_hand(hand_length),
        masks=_masks(performance, time_ns, hands, noise, switches),
        mps=mps,
        body=body_from_outputs(outputs, synthetic_smplh()),
        egoallo_outputs=outputs,
    )


def clock_start(performance: Performance) -> float:
    """Return the time of the ground truth's clock at the performance's first instant, whole microseconds, seconds."""
    return round(float(sensor_generator(performance, "time-code").uniform(*_TIME_CODE_START)), 6)


def clock_drift(performance: Performance, *, noise: float, switches: Switches) -> float:
    """Return how much faster the ground truth's clock runs than the glasses'."""
    drift = sensor_generator(performance, "clock-drift").uniform(-_LARGEST_DRIFT, _LARGEST_DRIFT)
    return float(drift * strength(switches.clock_drift, noise))


def frame_times(performance: Performance) -> Float[np.ndarray, " n"]:
    """Return the seconds from the performance's first instant: every RGB frame and the SLAM frame after it."""
    rgb = np.arange(int((performance.duration - SLAM_DELAY + 1e-9) * RATE) + 1) / RATE
    return np.column_stack([rgb, rgb + SLAM_DELAY]).ravel()


def native_object_id(object_id: str) -> str:
    """Return the uid under which the native files know an object: 15 digits."""
    return str(10**14 + int.from_bytes(hashlib.sha256(object_id.encode()).digest()[:8], "big") % (9 * 10**14))


def _has_quality_mask(performance: Performance) -> bool:
    """Return True for a recording of a newer release, which says in which frames the hands are right."""
    return performance.index % 2 == 0


def _has_wrong_start(performance: Performance, noise: float, switches: Switches) -> bool:
    """Return True where the hands of the first 0.7 s are wrong, as in several real recordings."""
    return strength(switches.hand_start, noise) > 0 and performance.index % _WRONG_EVERY == _WRONG_FIRST


def _nearest(time_us: Int[np.ndarray, " n"], query: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    right = np.clip(np.searchsorted(time_us, query), 1, len(time_us) - 1)
    return np.where(query - time_us[right - 1] <= time_us[right] - query, right - 1, right)


def _sense_objects(
    performance: Performance,
    times: Float[np.ndarray, " n"],
    time_ns: Int[np.ndarray, " n"],
    noise: float,
    switches: Switches,
) -> tuple[hot3d.Hot3dObject, ...]:
    objects = []
    for motion in performance.objects:
        track = performance.times[: len(motion.position)]
        rotation = Rotation.from_quat(slerp(track, motion.rotation, times), scalar_first=True)
        position = interpolate(track, motion.position, times) - rotation.apply(_ORIGIN)
        rng = sensor_generator(performance, f"object-noise-{motion.object_id}")
        scale = strength(switches.object_noise, noise)
        position = position + rng.normal(0.0, _OBJECT_NOISE, position.shape) * scale
        rotation = rotation * Rotation.from_rotvec(rng.normal(0.0, _OBJECT_TURN, position.shape) * scale)
        seen = ~(_lost(performance, motion, times) | _gaps(performance, motion, times, noise, switches))
        uid = native_object_id(motion.object_id)
        objects.append(
            hot3d.Hot3dObject(
                object_id=uid,
                name=f"{motion.name}_{uid[-4:]}",  # the library finds uids by name, too
                rows=_native_rows(time_ns, position, rotation, seen),
                mesh=box_mesh(motion.half_extents),
            )
        )
    return tuple(sorted(objects, key=lambda entry: entry.object_id))


def box_mesh(half_extents: Float[np.ndarray, "3"]) -> hot3d.ObjectMesh:
    """Return a box as twelve triangles in the object's frame, metres, rounded to micrometres."""
    corners = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
    return hot3d.ObjectMesh(np.round(corners * half_extents + _ORIGIN, _METRES), faces)


def _lost(performance: Performance, motion: ObjectMotion, times: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return the instants of ``lost`` events, at which nobody sees the object."""
    spans = [event.lost_span for event in performance.events if event.object_id == motion.object_id and event.lost_span]
    return _within(times, np.array(spans).reshape(-1, 2))


def _gaps(
    performance: Performance, motion: ObjectMotion, times: Float[np.ndarray, " n"], noise: float, switches: Switches
) -> Bool[np.ndarray, " n"]:
    """Return the runs of missing rows."""
    rng = sensor_generator(performance, f"object-gaps-{motion.object_id}")
    share = _GAP_SHARE * strength(switches.object_gaps, noise)
    count = rng.poisson(share * performance.duration / np.mean(_GAP_LENGTH))
    starts = rng.uniform(times[0], times[-1], count)
    return _within(times, np.column_stack([starts, starts + rng.uniform(*_GAP_LENGTH, count)]))


def _within(times: Float[np.ndarray, " n"], spans: Float[np.ndarray, "k 2"]) -> Bool[np.ndarray, " n"]:
    return np.asarray(((times >= spans[:, :1]) & (times <= spans[:, 1:])).any(axis=0))


def _sense_hand(
    performance: Performance,
    side: int,
    times: Float[np.ndarray, " n"],
    time_ns: Int[np.ndarray, " n"],
    noise: float,
    switches: Switches,
) -> hot3d.HandRows:
    joint = Joint.LEFT_WRIST + side
    wrist = interpolate(performance.times, performance.joints[:, joint], times)
    segment = Rotation.from_quat(slerp(performance.times, performance.rotations[:, joint], times), scalar_first=True)
    rng = sensor_generator(performance, f"hand-noise-{side}")
    scale = strength(switches.hand_noise, noise)
    sensed = wrist + rng.normal(0.0, _HAND_NOISE, wrist.shape) * scale
    if _has_wrong_start(performance, noise, switches):
        sensed[times < times[0] + _WRONG_START] += (0.0, _WRONG_BY, 0.0)
    seen = np.ones(len(times), dtype=bool)
    if strength(switches.hand_losses, noise):
        seen = _angle_off_head(performance, wrist, times) <= _HAND_SIGHT
    rows = _native_rows(time_ns, sensed, wrist_rotation(segment, side), seen)
    held = np.any([motion.held_by == side for motion in performance.objects if len(motion.held_by) > 1], axis=0)
    closed = uniform_filter1d(np.broadcast_to(held, performance.times.shape).astype(float), _frames(performance))
    angles = finger_angles(interpolate(performance.times, closed, times[seen]))
    name = ("left", "right")[side]
    return hot3d.HandRows(name, rows.time_ns, rows.position, rows.rotation, np.round(angles, _ANGLE), np.empty(0))


def _frames(performance: Performance) -> int:
    return max(1, round(_CLOSING * performance.rate))


def _angle_off_head(
    performance: Performance, points: Float[np.ndarray, "n 3"], times: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    head = Rotation.from_quat(slerp(performance.times, performance.head_rotation, times), scalar_first=True)
    local = head.inv().apply(points - interpolate(performance.times, performance.eye, times))
    return np.arctan2(np.linalg.norm(local[:, :2], axis=1), local[:, 2])


def _native_rows(
    time_ns: Int[np.ndarray, " n"],
    position: Float[np.ndarray, "n 3"],
    rotation: Rotation,
    seen: Bool[np.ndarray, " n"],
) -> hot3d.PoseRows:
    """Return those poses that were seen, in the native world, rounded."""
    turned = Rotation.from_matrix(NATIVE_FROM_WORLD[:3, :3]) * rotation
    quaternion = turned.as_quat(canonical=True, scalar_first=True)
    return hot3d.PoseRows(
        time_ns[seen],
        np.round(z_up(position), _METRES)[seen],
        np.round(quaternion, _QUATERNION)[seen],
    )


def _masks(
    performance: Performance,
    time_ns: Int[np.ndarray, " n"],
    hands: tuple[hot3d.HandRows, ...],
    noise: float,
    switches: Switches,
) -> dict[hot3d.MaskName, hot3d.MaskRows]:
    """Return flags of the RGB frames."""
    rgb = time_ns[::2]
    good = np.ones(len(rgb), dtype=bool)
    tracked = np.isin(rgb, np.concatenate([hand.time_ns for hand in hands]))
    masks: dict[hot3d.MaskName, hot3d.MaskRows] = {
        "headset_pose_available": hot3d.MaskRows(rgb, good),
        "object_pose_available": hot3d.MaskRows(rgb, good),
        "hand_pose_available": hot3d.MaskRows(rgb, tracked),
    }
    if _has_quality_mask(performance):
        wrong = _has_wrong_start(performance, noise, switches)
        passed = (rgb - rgb[0] >= round(_WRONG_START * 1e9)) | ~np.array(wrong)
        masks["qa_pass"] = hot3d.MaskRows(rgb, passed)
    return masks
