"""The Machine Perception Services for synthetic people: what they measure, and their files, for HOT3D and HD-EPIC.

Sources: docs/specification/synthetic-recordings.md#sensors and docs/specification/aria-mps.md. Readings are rounded to
the resolution of the written files, so that files and memory hold the same numbers. The native world is Z up: the
performance's, with the axes renamed.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_path, write_json
from prbench.geometry.skeleton import WRISTS, Y_UP_FROM_Z_UP, invert_rigid
from prbench.geometry.timelines import interpolate
from prbench.readers.aria_mps import format as mps
from prbench.readers.files import write_table
from prbench.synthetic.people.kinematics import wobble
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Sensing, Switches, closed_eyes, measured_gaze

Numbers = Float[np.ndarray, " n"]
Microseconds = Int[np.ndarray, " n"]
Points = Float[np.ndarray, "n 3"]

POSE_RATE = 1000
# Rows a second.
GAZE_RATE = 10
_HAND_RATE = 10
GLASSES_SIZE: mps.GlassesSize = "DVT-S"
GRAVITY = (0.0, 0.0, -9.81)  # In the native world.

_GAZE_MARGIN = np.array([-0.02, 0.02])  # The written uncertainty interval around an angle, radians.
_OWN_BIAS = np.deg2rad(1.0) / np.sqrt(2)
# Deviation of the constant error, radians an axis; larger without the wearer's own calibration.
GAZE_BIAS: dict[mps.GazeKind, float] = {"personalized": _OWN_BIAS, "general": 2.5 * _OWN_BIAS}
_GAZE_JITTER = np.deg2rad(0.5)
_GAZE_LOSS = 0.03
_GAZE_CLOCK_US = 16
_DRIFT = 5e-3
_DRIFT_TURN = np.deg2rad(0.3)
_DRIFT_HZ = (0.01, 0.05)
_WHITE = 0.2e-3
_WHITE_TURN = np.deg2rad(0.02)
_STARTING_ROWS = 101  # as in a real recording, while the estimator starts
_STARTING_QUALITY = 0.5
_GAZE_START_US = 20_000  # after the first pose
_HAND_START_US = 45_000
_DEPTH = (0.2, 4.0)  # m; what the files say of depth is wrong
_HAND_NOISE = 8e-3
_FIELD_OF_VIEW = np.deg2rad(60.0)
_METRES = 6  # decimals
_QUATERNION = 9
_RADIANS = 6


def sense_mps(
    performance: Performance,
    *,
    start_us: int,
    noise: float = 1.0,
    switches: Switches | None = None,
    gaze_kind: mps.GazeKind = "personalized",
    step_jitter_us: int = 0,
    hands: bool = True,
    slam_gaps: Sequence[tuple[float, float]] = (),
) -> mps.MpsReadings:
    """Sense the trajectory at 1 kHz (all rows), gaze at 10 Hz, wrists at 10 Hz.

    Args:
        performance: The truth.
        start_us: Device time of the performance's first instant, microseconds.
        noise: Multiplies every error; 0 for ideal sensors.
        switches: Which errors are on; all if None.
        gaze_kind: Without the wearer's own calibration ("general") the gaze bias is 2.5 times as large.
        step_jitter_us: Largest error of the 1 kHz time steps: 2 for HD-EPIC, 0 for HOT3D.
        hands: Whether the services found hands.
        slam_gaps: Spans without poses, seconds after the first instant.
    """
    sensing = Sensing(performance, noise, switches or Switches())
    n = int((performance.duration + 1e-9) * POSE_RATE) + 1
    since_start = np.arange(n) * (1_000_000 // POSE_RATE)
    if sensing.switches.pose_clock and step_jitter_us:
        rng = sensing.generator("mps-pose-clock")
        since_start[1:] += rng.integers(-step_jitter_us, step_jitter_us, n, endpoint=True)[1:]
    since_start = np.clip(since_start, 0, round(performance.duration * 1e6))
    times = performance.times[0] + since_start / 1e6
    position, rotation = _native_poses(sensing, times)
    # The slow errors of the estimated world: shift, metres, and rotation vector, radians.
    scale = sensing.strength("pose_drift")
    errors = np.zeros((n, 6))
    if scale:
        rng = sensing.generator("mps-pose-drift")
        waves = [wobble(times, rms, *_DRIFT_HZ, rng) * scale for rms in [_DRIFT] * 3 + [_DRIFT_TURN] * 3]
        errors = np.stack(waves, axis=1)
    shift, turn = np.hsplit(errors, 2)
    rng = sensing.generator("mps-pose-noise")
    scale = sensing.strength("pose_noise")
    shift += rng.normal(0.0, _WHITE, (n, 3)) * scale
    turn += rng.normal(0.0, _WHITE_TURN, (n, 3)) * scale
    turned = Rotation.from_rotvec(turn) * rotation
    gaze_since_start = _steps(performance, _GAZE_START_US, GAZE_RATE)
    gaze_times = performance.times[0] + gaze_since_start / 1e6
    depth = sensing.generator("mps-gaze-depth").uniform(*_DEPTH, len(gaze_times))
    gaze = gaze_rows(sensing, gaze_times, start_us + gaze_since_start, depth, gaze_kind)
    position = np.round(position + shift, _METRES)
    quaternion = np.round(turned.as_quat(canonical=True, scalar_first=True), _QUATERNION)
    quality = np.where(np.arange(n) < _STARTING_ROWS, _STARTING_QUALITY, 1.0)
    up = -np.array(GRAVITY) / np.linalg.norm(GRAVITY)
    world = (up, (graph_uid(performance),))
    trajectory = mps.AriaTrajectory(start_us + since_start, position, quaternion, quality, *world)
    # The files hold the yaws of two equal eyes: combining them costs the last bit.
    yaw_range = mps.combined_yaw(gaze.yaw_range, gaze.yaw_range)
    gaze = replace(gaze, yaw=mps.combined_yaw(gaze.yaw, gaze.yaw), yaw_range=yaw_range)
    wrists = _sense_hands(sensing, start_us) if hands else None
    readings = mps.MpsReadings(trajectory, gaze, gaze_kind, wrists, GLASSES_SIZE, device_from_rgb())
    spans = [(start_us + round(begin * 1e6), start_us + round(end * 1e6)) for begin, end in slam_gaps]
    return with_slam_gaps(readings, spans)


def with_slam_gaps(readings: mps.MpsReadings, spans_us: Sequence[tuple[int, int]]) -> mps.MpsReadings:
    """Return the readings without the poses strictly inside of some spans (device microseconds) of lost tracking."""
    time_us = readings.trajectory.time_us
    lost = [(time_us > start) & (time_us < end) for start, end in spans_us]
    if not lost:
        return readings
    return replace(readings, trajectory=mps.trajectory_rows(readings.trajectory, np.flatnonzero(~np.any(lost, axis=0))))


def device_from_rgb() -> Float[np.ndarray, "4 4"]:
    """Return the nominal pose of the RGB camera, to the last bit as it comes back from a quaternion in a file."""
    transform = mps.device_from_cpf(GLASSES_SIZE) @ mps.cpf_from_rgb()
    for _ in range(8):  # rounding settles after one or two steps
        quaternion = Rotation.from_matrix(transform[:3, :3]).as_quat(canonical=True)
        transform[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    return transform


def _native_poses(sensing: Sensing, times: Numbers) -> tuple[Points, Rotation]:
    """Return noise-free positions and rotations of the device in the native world; ``times`` in performance seconds."""
    position, rotation = device_poses(sensing, times, GLASSES_SIZE)
    native_from_world = Y_UP_FROM_Z_UP[:3, :3].T
    return position @ native_from_world.T, Rotation.from_matrix(native_from_world) * rotation


def device_poses(sensing: Sensing, times: Numbers, size: mps.GlassesSize) -> tuple[Points, Rotation]:
    """Return noise-free positions (metres) and rotations of the glasses' device frame in the performance's world."""
    cpf = sensing.head(times)
    cpf_from_device = invert_rigid(mps.device_from_cpf(size))
    return sensing.eye(times) + cpf.apply(cpf_from_device[:3, 3]), cpf * Rotation.from_matrix(cpf_from_device[:3, :3])


def graph_uid(performance: Performance) -> str:
    """Return the id of the native world: one for all recordings of a participant, as in multi-recording SLAM."""
    return uid_of(f"{performance.preset}/{performance.seed}/{performance.person.participant_id}")


def uid_of(identity: str) -> str:
    """Return a UUID that depends on a text alone."""
    return str(uuid.UUID(bytes=hashlib.sha256(identity.encode()).digest()[:16]))


def gaze_rows(
    sensing: Sensing, times: Numbers, time_us: Microseconds, depth: Numbers, gaze_kind: mps.GazeKind = "personalized"
) -> mps.GazeAngles:
    """Return the gaze rows that the files have: some are lost, those of blinks hold NaN, stamps are a little off.

    Args:
        sensing: The truth and its errors.
        times: When the eyes are looked at, performance seconds.
        time_us: The same instants on the device clock, microseconds.
        depth: Written distances of the point looked at, metres.
        gaze_kind: Without the wearer's own calibration ("general") the bias is larger.
    """
    bias = GAZE_BIAS[gaze_kind]
    angles = measured_gaze(sensing, sensing.head(times), sensing.gaze(times), bias=bias, jitter=_GAZE_JITTER)
    angles[closed_eyes(sensing, times)] = np.nan
    kept = sensing.generator("gaze-losses").random(len(times)) >= _GAZE_LOSS * sensing.strength("gaze_losses")
    shift = sensing.generator("gaze-clock").uniform(-_GAZE_CLOCK_US, _GAZE_CLOCK_US, len(times))
    stamps = time_us + np.rint(shift * sensing.strength("gaze_clock")).astype(np.int64)
    yaw, pitch = np.round(angles[kept], _RADIANS).T
    ranges = (np.round(angle[:, None] + _GAZE_MARGIN, _RADIANS) for angle in (yaw, pitch))
    return mps.GazeAngles(stamps[kept], yaw, pitch, np.round(depth, _METRES)[kept], *ranges)


def _sense_hands(sensing: Sensing, start_us: int) -> mps.WristPositions:
    performance = sensing.performance
    since_start = _steps(performance, _HAND_START_US, _HAND_RATE)
    times = performance.times[0] + since_start / 1e6
    wrist = interpolate(performance.times, performance.joints[:, list(WRISTS)], times)
    palm = (wrist + interpolate(performance.times, performance.finger_bases, times)) / 2
    error = sensing.generator("mps-hand-noise").normal(0.0, _HAND_NOISE, wrist.shape) * sensing.strength("hand_noise")
    # 1 straight ahead, less towards the edge of the view, -1 beyond it; always 1 without losses.
    scale = sensing.strength("hand_losses")
    away = wrist - sensing.eye(times)[:, None]
    ahead = np.einsum("nhk,nk->nh", away, sensing.head(times).apply((0.0, 0.0, 1.0))) / np.linalg.norm(away, axis=2)
    angle = np.arccos(np.clip(ahead, -1.0, 1.0)) / _FIELD_OF_VIEW
    doubt = np.abs(sensing.generator("mps-hand-confidence").normal(0.0, 0.03, angle.shape))
    confidence = np.round(np.clip(1.0 - scale * (0.5 * angle**4 + doubt), 0.01, 1.0), _METRES)
    confidence = np.where((angle > 1.0) & (scale > 0), -1.0, confidence)
    seen = (confidence > 0)[..., None]
    # Points of the performance's world in the true device frame.
    position, rotation = _native_poses(sensing, times)
    axes = rotation.as_matrix()
    local = ((part + error) @ Y_UP_FROM_Z_UP[:3, :3] - position[:, None] for part in (wrist, palm))
    sensed = (np.round(np.einsum("nji,nhj->nhi", axes, points), _METRES) for points in local)
    return mps.WristPositions(start_us + since_start, confidence, *(np.where(seen, part, np.nan) for part in sensed))


def _steps(performance: Performance, first_us: int, rate: int) -> Microseconds:
    """Return the microseconds since the first instant, at a steady rate, until the performance ends."""
    return np.arange(first_us, int(performance.duration * 1e6) - 50, 1_000_000 // rate)


_ROLES = (mps.TRAJECTORY, mps.GAZE, mps.CALIBRATION, mps.WRISTS, mps.SLAM_SUMMARY, mps.GAZE_SUMMARY, mps.HAND_SUMMARY)
_EYES = {"tx_left_eye_cpf": 0.0315, "tx_right_eye_cpf": -0.0315}
_NO_SESSION = "00000000-0000-0000-0000-000000000000"
# Places of the SLAM cameras on the glasses, metres; their distance tells the size of the glasses.
_CAMERAS = {"camera-slam-left": (0.0, 0.0, 0.0), "camera-slam-right": (0.006, -0.138, 0.0)}
_LARGE_GLASSES = 0.1427 / 0.1381
_CALIBRATION_STEP_US = 1_000_000


def write_mps(readings: mps.MpsReadings, folder: Path, *, only: Collection[str] | None = None) -> None:
    """Write ``slam/``, ``eye_gaze/`` and ``hand_tracking/`` below a folder.

    Args:
        readings: All that the files say; whole, not thinned.
        folder: The root of one recording's outputs.
        only: Roles (:data:`_ROLES`) to write; all if None.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    wanted = set(_ROLES if only is None else only)
    slam, gaze, hands = (folder / name for name in (mps.SLAM_FOLDER, mps.GAZE_FOLDER, mps.HAND_FOLDER))
    if mps.TRAJECTORY in wanted:
        trajectory = readings.trajectory
        n = len(trajectory.time_us)
        columns = mps.trajectory_columns(trajectory, trajectory.graph_uids[0], GRAVITY, _velocities(trajectory))
        columns["geo_available"] = np.zeros(n, dtype=np.int64)
        columns |= {f"t{axis}_ecef_device": np.zeros(n) for axis in "xyz"}
        columns |= {f"q{axis}_ecef_device": np.full(n, float(axis == "w")) for axis in "xyzw"}
        write_csv(slam / mps.TRAJECTORY_FILE, columns)
    if mps.CALIBRATION in wanted and readings.glasses_size is not None:
        first, last = readings.trajectory.time_us[[0, -1]]
        scale = _LARGE_GLASSES if readings.glasses_size == "DVT-L" else 1.0
        poses = {}
        for label, place in _CAMERAS.items():
            poses[label] = np.eye(4)
            poses[label][:3, 3] = np.array(place) * scale
        if readings.device_from_rgb is not None:
            poses["camera-rgb"] = readings.device_from_rgb
        # Focal length and principal point, pixels: 2880 x 2880 for RGB, 640 x 480 for SLAM.
        pixels = dict.fromkeys(_CAMERAS, (242.0, 320.0, 240.0)) | {"camera-rgb": (1220.0, 1440.0, 1440.0)}
        cameras = [
            {
                "Label": label,
                "Calibrated": True,
                "SerialNumber": "",
                "T_Device_Camera": _pose_record(pose),
                "Projection": {"Name": "FisheyeRadTanThinPrism", "Params": [*pixels[label], *[0.0] * 12]},
            }
            for label, pose in poses.items()
        ]
        unit = np.eye(3).tolist()
        bias = {"Name": "Constant", "Offset": [0.0, 0.0, 0.0]}
        zero = np.zeros((3, 3)).tolist()
        turning = {"Name": "LinearGSensitivity", "RectificationMatrix": unit, "GSensitivityMatrix": zero}
        moving = {"Name": "UpperTriagonalLinear", "RectificationMatrix": unit}
        imus = [
            {
                "Label": label,
                "Calibrated": True,
                "SerialNumber": "",
                "Gyroscope": {"TimeOffsetSec_Device_Gyro": 0.0, "Bias": bias, "Model": turning},
                "Accelerometer": {"TimeOffsetSec_Device_Accel": 0.0, "Bias": bias, "Model": moving},
                "T_Device_Imu": _pose_record(np.eye(4)),
            }
            for label in ("imu-right", "imu-left")
        ]
        with atomic_path(slam / mps.CALIBRATION_FILE) as temporary, open(temporary, "wb") as file:
            for time_us in range(int(first), int(last) + 1, _CALIBRATION_STEP_US):
                stamps = {"utc_timestamp_ns": -1, "tracking_timestamp_us": time_us}
                record = {**stamps, "ImuCalibrations": imus, "CameraCalibrations": cameras}
                file.write(msgspec.json.encode(record) + b"\n")
    if mps.SLAM_SUMMARY in wanted:
        write_json(slam / mps.SUMMARY_FILE, {"SLAM": {"status": "SUCCESS", "info": [], "warnings": [], "errors": []}})
    if mps.GAZE in wanted:
        # The schema of two eyes, which here look in parallel.
        angles = readings.gaze
        columns = {mps.TIME_COLUMN: angles.time_us}
        columns |= dict.fromkeys((mps.LEFT_YAW, mps.RIGHT_YAW), np.round(angles.yaw, 6))
        columns |= {mps.PITCH: angles.pitch, mps.DEPTH: angles.depth}
        for bound in (0, 1):
            yaw = np.round(angles.yaw_range[:, bound], 6)
            columns |= {mps.LEFT_YAW_RANGE[bound]: yaw, mps.RIGHT_YAW_RANGE[bound]: yaw}
            columns[mps.PITCH_RANGE[bound]] = angles.pitch_range[:, bound]
        n = len(angles.time_us)
        eyes = [f"t{axis}_{side}_eye_cpf" for side in mps.SIDES for axis in "xyz"]
        columns |= {name: np.full(n, _EYES.get(name, 0.0)) for name in eyes}
        write_csv(gaze / f"{readings.gaze_kind}_eye_gaze.csv", columns | {"session_uid": np.full(n, _NO_SESSION)})
    if mps.GAZE_SUMMARY in wanted:
        write_json(gaze / mps.SUMMARY_FILE, {"GazeInference": {"status": "SUCCESS", "message": ""}, "version": "3.0"})
    if mps.WRISTS in wanted and readings.wrists is not None:
        wrists = readings.wrists
        columns = {mps.TIME_COLUMN: wrists.time_us}
        for index, side in enumerate(mps.SIDES):
            columns[f"{side}_tracking_confidence"] = wrists.confidence[:, index]
            for part, points in (("wrist", wrists.wrist), ("palm", wrists.palm)):
                assert points is not None  # as sensed
                names = [f"t{axis}_{side}_{part}_device" for axis in "xyz"]
                columns |= mps.split_columns(names, np.nan_to_num(points[:, index], nan=0.0))
        write_csv(hands / mps.WRISTS_FILE, columns)
    if mps.HAND_SUMMARY in wanted and readings.wrists is not None:
        write_json(hands / mps.SUMMARY_FILE, {"HandTracking": {"status": "SUCCESS", "message": ""}})


def _velocities(trajectory: mps.AriaTrajectory) -> Float[np.ndarray, "n 6"]:
    """Return linear (m/s) and angular (rad/s) velocity in the device frame, between neighbouring rows."""
    rotation = Rotation.from_quat(trajectory.rotation, scalar_first=True)
    if len(rotation) < 2:
        return np.zeros((len(rotation), 6))
    step = np.diff(trajectory.time_us)[:, None] / 1e6
    linear = rotation[:-1].inv().apply(np.diff(trajectory.position, axis=0) / step)
    angular = (rotation[:-1].inv() * rotation[1:]).as_rotvec() / step
    both = np.hstack([linear, angular])
    return np.round(np.vstack([both, both[-1:]]), 6)


def _pose_record(pose: Float[np.ndarray, "4 4"]) -> dict[str, object]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()
    return {"Translation": pose[:3, 3].tolist(), "UnitQuaternion": [w, [x, y, z]]}


def pose_columns(bodies: Mapping[Any, Any]) -> dict[str, object]:
    """Return the table of poses that ADT and HOT3D have, rows in the order of time.

    Args:
        bodies: Objects with ``time_ns``, ``position`` and ``rotation`` by id.
    """
    times, position, rotation = (
        np.concatenate([getattr(rows, name) for rows in bodies.values()])
        for name in ("time_ns", "position", "rotation")
    )
    order = np.argsort(times, kind="stable")
    return {
        mps.OBJECT_ID: np.concatenate([np.full(len(rows.time_ns), body) for body, rows in bodies.items()])[order],
        mps.OBJECT_TIME: times[order],
        **mps.split_columns(mps.OBJECT_POSITION, position[order]),
        **mps.split_columns(mps.OBJECT_ROTATION, rotation[order]),
    }


def write_csv(path: Path, columns: Mapping[str, object]) -> None:
    """Write a table: plain header, no quotes, empty cells for NaN.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        write_table(file, table)
