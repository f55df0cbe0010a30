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

from prbench.geometry.axes import z_up
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import interpolate, slerp
from prbench.readers.aria_mps.synthetic_sensors import sense_mps
from prbench.readers.egoallo.synthetic import NATIVE_FROM_WORLD, sense_egoallo
from prbench.readers.egoallo.synthetic_smplh import synthetic_smplh
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.synthetic_hand import finger_angles, synthetic_hand, wrist_rotation
from prbench.synthetic.performance import ObjectMotion, Performance
from prbench.synthetic.sensors import (
    Sensing,
    Switches,
    device_start_us,
    sensor_generator,
    tracked,
    untracked,
    within,
)

RATE = 30.0
"""RGB frames, Hz; SLAM frames follow each after :data:`SLAM_DELAY`."""
SLAM_DELAY = 91e-6
"""Seconds."""

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
    sensing = Sensing(performance, noise, switches or Switches())
    since = frame_times(performance)
    drift = clock_drift(sensing)
    time_ns = round(clock_start(performance) * 1e9) + np.rint(since * 1e9 * (1 + drift)).astype(np.int64)
    start_us = device_start_us(performance)
    mps = sense_mps(performance, start_us=start_us, noise=noise, switches=switches, hands=False)
    outputs = sense_egoallo(performance, mps.trajectory, noise=noise, switches=switches, start_us=start_us)
    times = performance.times[0] + since
    hands = tuple(_sense_hand(sensing, side, times, time_ns) for side in (0, 1))
    trajectory = mps.trajectory
    row = _nearest(trajectory.time_us, start_us + np.rint(since * 1e6).astype(np.int64))
    hand_length = float(np.linalg.norm(performance.finger_bases[0, 0] - performance.joints[0, Joint.LEFT_WRIST]))
    return hot3d.Hot3dReadings(
        recording_id=performance.recording_id,
        participant_id=performance.person.participant_id,
        headset=hot3d.PoseRows(time_ns, trajectory.position[row], trajectory.rotation[row]),
        objects=_sense_objects(sensing, times, time_ns),
        hands=hands,
        hand_model=synthetic_hand(hand_length),
        masks=_masks(sensing, time_ns, hands),
        mps=mps,
        body=body_from_outputs(outputs, synthetic_smplh()),
        egoallo_outputs=outputs,
    )


def clock_start(performance: Performance) -> float:
    """Return the time of the ground truth's clock at the performance's first instant, whole microseconds, seconds."""
    return round(float(sensor_generator(performance, "time-code").uniform(*_TIME_CODE_START)), 6)


def clock_drift(sensing: Sensing) -> float:
    """Return how much faster the ground truth's clock runs than the glasses'."""
    drift = sensing.generator("clock-drift").uniform(-_LARGEST_DRIFT, _LARGEST_DRIFT)
    return float(drift * sensing.strength("clock_drift"))


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


def _has_wrong_start(sensing: Sensing) -> bool:
    """Return True where the hands of the first 0.7 s are wrong, as in several real recordings."""
    return sensing.strength("hand_start") > 0 and sensing.performance.index % _WRONG_EVERY == _WRONG_FIRST


def _nearest(time_us: Int[np.ndarray, " n"], query: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    right = np.clip(np.searchsorted(time_us, query), 1, len(time_us) - 1)
    return np.where(query - time_us[right - 1] <= time_us[right] - query, right - 1, right)


def _sense_objects(
    sensing: Sensing, times: Float[np.ndarray, " n"], time_ns: Int[np.ndarray, " n"]
) -> tuple[hot3d.Hot3dObject, ...]:
    performance = sensing.performance
    scale = sensing.strength("object_noise")
    objects = []
    for motion in performance.objects:
        track = performance.times[: len(motion.position)]
        rotation = Rotation.from_quat(slerp(track, motion.rotation, times), scalar_first=True)
        position = interpolate(track, motion.position, times) - rotation.apply(_ORIGIN)
        position, rotation = tracked(sensing, motion.object_id, position, rotation, size=_OBJECT_NOISE, scale=scale)
        seen = ~(untracked(performance, motion, times) | _gaps(sensing, motion, times))
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


def _gaps(sensing: Sensing, motion: ObjectMotion, times: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return the runs of missing rows."""
    rng = sensing.generator(f"object-gaps-{motion.object_id}")
    share = _GAP_SHARE * sensing.strength("object_gaps")
    count = rng.poisson(share * sensing.performance.duration / np.mean(_GAP_LENGTH))
    starts = rng.uniform(times[0], times[-1], count)
    return within(times, np.column_stack([starts, starts + rng.uniform(*_GAP_LENGTH, count)]))


def _sense_hand(
    sensing: Sensing, side: int, times: Float[np.ndarray, " n"], time_ns: Int[np.ndarray, " n"]
) -> hot3d.HandRows:
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
        seen = _angle_off_head(sensing, wrist, times) <= _HAND_SIGHT
    rows = _native_rows(time_ns, sensed, wrist_rotation(segment, side), seen)
    held = np.any([motion.held_by == side for motion in performance.objects if len(motion.held_by) > 1], axis=0)
    # Fingers close and open within a window around the grasp, not in one frame.
    window = max(1, round(_CLOSING * performance.rate))
    closed = uniform_filter1d(np.broadcast_to(held, performance.times.shape).astype(float), window)
    angles = finger_angles(interpolate(performance.times, closed, times[seen]))
    name = ("left", "right")[side]
    return hot3d.HandRows(name, rows.time_ns, rows.position, rows.rotation, np.round(angles, _ANGLE), np.empty(0))


def _angle_off_head(
    sensing: Sensing, points: Float[np.ndarray, "n 3"], times: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    local = sensing.head(times).inv().apply(points - sensing.eye(times))
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
    sensing: Sensing, time_ns: Int[np.ndarray, " n"], hands: tuple[hot3d.HandRows, ...]
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
    if _has_quality_mask(sensing.performance):
        passed = good if not _has_wrong_start(sensing) else rgb - rgb[0] >= round(_WRONG_START * 1e9)
        masks["qa_pass"] = hot3d.MaskRows(rgb, passed)
    return masks
