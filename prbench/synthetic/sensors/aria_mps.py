"""Imitates the Machine Perception Services for a performance (docs/specification/synthetic-recordings.md#sensors).

For HOT3D and HD-EPIC. Readings are rounded to the resolution of the written files, so that files and memory hold the
same numbers. The native world is Z up: the performance's, with the axes renamed.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.axes import Y_UP_FROM_Z_UP
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.format import GazeKind, gaze_angles
from prbench.skeleton import WRISTS, invert_rigid
from prbench.synthetic.people.channels import wobble
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors.errors import Switches, sensor_generator, strength
from prbench.timelines import interpolate, slerp

GAZE_MARGIN = 0.02
"""Radians, half of the written uncertainty interval."""
_GAZE_BIAS = np.deg2rad(1.0) / np.sqrt(2)
_GAZE_JITTER = np.deg2rad(0.5)
_GENERAL = 2.5  # how much larger the bias is without the wearer's own calibration
_GAZE_LOSS = 0.03
_GAZE_CLOCK_US = 16
_BLINKS_A_MINUTE = 15.0  # s
_BLINK = 0.15


def gaze_bias(
    performance: Performance, *, noise: float, switches: Switches, gaze_kind: GazeKind = "personalized"
) -> tuple[float, float]:
    """Return the recording's constant gaze error, yaw and pitch, radians."""
    size = _GAZE_BIAS * (_GENERAL if gaze_kind == "general" else 1.0)
    bias = sensor_generator(performance, "gaze-bias").normal(0.0, size, 2)
    yaw, pitch = bias * strength(switches.gaze_bias, noise)
    return float(yaw), float(pitch)


def gaze_measurements(
    performance: Performance,
    times: Float[np.ndarray, " n"],
    *,
    noise: float,
    switches: Switches,
    gaze_kind: GazeKind = "personalized",
) -> Float[np.ndarray, "n 2"]:
    """Return the yaw and pitch with bias and jitter, radians; NaN while the eyes are closed.

    Args:
        performance: The truth.
        times: When the eyes are looked at, performance seconds.
        noise: Multiplies every error.
        switches: Which errors are on.
        gaze_kind: Without the wearer's own calibration the bias is larger.
    """
    head = Rotation.from_quat(slerp(performance.times, performance.head_rotation, times), scalar_first=True)
    angles = np.column_stack(gaze_angles(head.inv().apply(interpolate(performance.times, performance.gaze, times))))
    angles += gaze_bias(performance, noise=noise, switches=switches, gaze_kind=gaze_kind)
    jitter = sensor_generator(performance, "gaze-jitter").normal(0.0, _GAZE_JITTER, (len(times), 2))
    angles += jitter * strength(switches.gaze_jitter, noise)
    angles[_blinks(performance, times, strength(switches.blinks, noise))] = np.nan
    return angles


def lost_gaze(performance: Performance, n: int, *, noise: float, switches: Switches) -> Bool[np.ndarray, " n"]:
    """Return rows that the files lack."""
    share = _GAZE_LOSS * strength(switches.gaze_losses, noise)
    return np.asarray(sensor_generator(performance, "gaze-losses").random(n) < share)


def gaze_clock_us(performance: Performance, n: int, *, noise: float, switches: Switches) -> Int[np.ndarray, " n"]:
    """Return the errors of the time stamps, microseconds."""
    shift = sensor_generator(performance, "gaze-clock").uniform(-_GAZE_CLOCK_US, _GAZE_CLOCK_US, n)
    return np.rint(shift * strength(switches.gaze_clock, noise)).astype(np.int64)


def _blinks(performance: Performance, times: Float[np.ndarray, " n"], scale: float) -> Bool[np.ndarray, " n"]:
    rng = sensor_generator(performance, "blinks")
    count = rng.poisson(_BLINKS_A_MINUTE / 60.0 * performance.duration)
    starts = rng.uniform(times[0], times[-1], count)
    closed = np.minimum(_BLINK * scale, 1.0)
    return ((times >= starts[:, None]) & (times < starts[:, None] + closed)).any(axis=0)


POSE_RATE = 1000
GAZE_RATE = 10
_HAND_RATE = 10
"""Hz."""
GLASSES_SIZE: mps.GlassesSize = "DVT-S"
GRAVITY = (0.0, 0.0, -9.81)
"""In the native world."""

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
    switches = switches or Switches()
    trajectory = _sense_poses(performance, start_us, noise, switches, step_jitter_us)
    readings = mps.MpsReadings(
        trajectory=trajectory,
        gaze=_sense_gaze(performance, start_us, noise, switches, gaze_kind),
        gaze_kind=gaze_kind,
        wrists=_sense_hands(performance, start_us, noise, switches) if hands else None,
        glasses_size=GLASSES_SIZE,
        device_from_rgb=device_from_rgb(),
    )
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


def graph_uid(performance: Performance) -> str:
    """Return the id of the native world: one for all recordings of a participant, as in multi-recording SLAM."""
    identity = f"{performance.preset}/{performance.seed}/{performance.person.participant_id}"
    return str(uuid.UUID(bytes=hashlib.sha256(identity.encode()).digest()[:16]))


def _true_device_poses(
    performance: Performance, times: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Rotation]:
    """Return noise-free positions and rotations of the device in the native world; ``times`` in performance seconds."""
    cpf = Rotation.from_quat(slerp(performance.times, performance.head_rotation, times), scalar_first=True)
    cpf_from_device = invert_rigid(mps.device_from_cpf(GLASSES_SIZE))
    rotation = cpf * Rotation.from_matrix(cpf_from_device[:3, :3])
    position = interpolate(performance.times, performance.eye, times) + cpf.apply(cpf_from_device[:3, 3])
    native_from_world = Y_UP_FROM_Z_UP[:3, :3].T
    return position @ native_from_world.T, Rotation.from_matrix(native_from_world) * rotation


def _sense_poses(
    performance: Performance, start_us: int, noise: float, switches: Switches, step_jitter_us: int
) -> mps.AriaTrajectory:
    n = int((performance.duration + 1e-9) * POSE_RATE) + 1
    since_start = np.arange(n) * (1_000_000 // POSE_RATE) + _step_errors(performance, n, switches, step_jitter_us)
    since_start = np.clip(since_start, 0, round(performance.duration * 1e6))
    times = performance.times[0] + since_start / 1e6
    position, rotation = _true_device_poses(performance, times)
    shift, turn = _drift(performance, times, strength(switches.pose_drift, noise))
    rng = sensor_generator(performance, "mps-pose-noise")
    scale = strength(switches.pose_noise, noise)
    shift += rng.normal(0.0, _WHITE, (n, 3)) * scale
    turn += rng.normal(0.0, _WHITE_TURN, (n, 3)) * scale
    quality = np.where(np.arange(n) < _STARTING_ROWS, _STARTING_QUALITY, 1.0)
    return mps.AriaTrajectory(
        time_us=start_us + since_start,
        position=np.round(position + shift, _METRES),
        rotation=np.round(
            (Rotation.from_rotvec(turn) * rotation).as_quat(canonical=True, scalar_first=True), _QUATERNION
        ),
        quality=quality,
        up=-np.array(GRAVITY) / np.linalg.norm(GRAVITY),
        graph_uids=(graph_uid(performance),),
        left_out=0,
    )


def _step_errors(performance: Performance, n: int, switches: Switches, largest_us: int) -> Int[np.ndarray, " n"]:
    if not (switches.pose_clock and largest_us):
        return np.zeros(n, dtype=np.int64)
    errors = sensor_generator(performance, "mps-pose-clock").integers(-largest_us, largest_us, n, endpoint=True)
    errors[0] = 0
    return errors


def _drift(
    performance: Performance, times: Float[np.ndarray, " n"], scale: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return the slow errors of the estimated world: shift, metres, and rotation vector, radians."""
    if scale == 0:
        return np.zeros((len(times), 3)), np.zeros((len(times), 3))
    rng = sensor_generator(performance, "mps-pose-drift")
    waves = [wobble(times, rms, *_DRIFT_HZ, rng) * scale for rms in [_DRIFT] * 3 + [_DRIFT_TURN] * 3]
    return np.stack(waves[:3], axis=1), np.stack(waves[3:], axis=1)


def _sense_gaze(
    performance: Performance, start_us: int, noise: float, switches: Switches, gaze_kind: mps.GazeKind
) -> mps.GazeAngles:
    since_start = _steps(performance, _GAZE_START_US, GAZE_RATE)
    times = performance.times[0] + since_start / 1e6
    n = len(since_start)
    angles = gaze_measurements(performance, times, noise=noise, switches=switches, gaze_kind=gaze_kind)
    time_us = start_us + since_start + gaze_clock_us(performance, n, noise=noise, switches=switches)
    depth = sensor_generator(performance, "mps-gaze-depth").uniform(*_DEPTH, n)
    kept = ~lost_gaze(performance, n, noise=noise, switches=switches)
    yaw, pitch = np.round(angles[kept], _RADIANS).T
    margin = np.array([-GAZE_MARGIN, GAZE_MARGIN])
    yaw_range = np.round(yaw[:, None] + margin, _RADIANS)
    return mps.GazeAngles(
        time_us[kept],
        mps.combined_yaw(yaw, yaw),  # of two equal eyes, as the files hold them
        pitch,
        np.round(depth, _METRES)[kept],
        mps.combined_yaw(yaw_range, yaw_range),
        np.round(pitch[:, None] + margin, _RADIANS),
    )


def _sense_hands(performance: Performance, start_us: int, noise: float, switches: Switches) -> mps.WristPositions:
    since_start = _steps(performance, _HAND_START_US, _HAND_RATE)
    times = performance.times[0] + since_start / 1e6
    wrist = interpolate(performance.times, performance.joints[:, list(WRISTS)], times)
    palm = (wrist + interpolate(performance.times, performance.finger_bases, times)) / 2
    rng = sensor_generator(performance, "mps-hand-noise")
    scale = strength(switches.hand_noise, noise)
    error = rng.normal(0.0, _HAND_NOISE, wrist.shape) * scale
    confidence = _hand_confidence(performance, times, wrist, strength(switches.hand_losses, noise))
    seen = (confidence > 0)[..., None]
    return mps.WristPositions(
        start_us + since_start,
        confidence,
        np.where(seen, np.round(_in_device(performance, times, wrist + error), _METRES), np.nan),
        np.where(seen, np.round(_in_device(performance, times, palm + error), _METRES), np.nan),
    )


def _hand_confidence(
    performance: Performance, times: Float[np.ndarray, " n"], wrist: Float[np.ndarray, "n 2 3"], scale: float
) -> Float[np.ndarray, "n 2"]:
    """Return 1 straight ahead, less towards the edge of the view, -1 beyond it; always 1 where ``scale`` is 0."""
    head = Rotation.from_quat(slerp(performance.times, performance.head_rotation, times), scalar_first=True)
    away = wrist - interpolate(performance.times, performance.eye, times)[:, None]
    ahead = np.einsum("nhk,nk->nh", away, head.apply((0.0, 0.0, 1.0))) / np.linalg.norm(away, axis=2)
    angle = np.arccos(np.clip(ahead, -1.0, 1.0)) / _FIELD_OF_VIEW
    doubt = np.abs(sensor_generator(performance, "mps-hand-confidence").normal(0.0, 0.03, angle.shape))
    confidence = np.round(np.clip(1.0 - scale * (0.5 * angle**4 + doubt), 0.01, 1.0), _METRES)
    return np.where((angle > 1.0) & (scale > 0), -1.0, confidence)


def _in_device(
    performance: Performance, times: Float[np.ndarray, " n"], points: Float[np.ndarray, "n 2 3"]
) -> Float[np.ndarray, "n 2 3"]:
    """Return points of the performance's world in the true device frame."""
    position, rotation = _true_device_poses(performance, times)
    native = points @ Y_UP_FROM_Z_UP[:3, :3] - position[:, None]
    return np.einsum("nji,nhj->nhi", rotation.as_matrix(), native)


def _steps(performance: Performance, first_us: int, rate: int) -> Int[np.ndarray, " n"]:
    """Return the microseconds since the first instant, at a steady rate, until the performance ends."""
    return np.arange(first_us, int(performance.duration * 1e6) - 50, 1_000_000 // rate)
