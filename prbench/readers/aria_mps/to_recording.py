"""Converts what the Machine Perception Services say of Aria glasses to streams in the world.

Source: docs/specification/aria-mps.md.

Readers of HOT3D and HD-EPIC call this with what the files hold, synthetic recordings with what their sensors say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.geometry.timelines import covered
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP, WIDEST_GAZE_ANGLE, gaze_directions_cpf
from prbench.recording import SIDES, GazeStream, HandStream, PoseStream

ASSUMED_SIZE: mps.GlassesSize = "DVT-S"  # Size of glasses where no file tells it.
SAME_INSTANT = 1e-3  # Seconds; the step of the poses.


@dataclass(frozen=True)
class MpsStreams:
    """Streams of one recording, in the world, on the recording's clock.

    Attributes:
        head: Central pupil frame.
        camera: RGB camera.
        wrists: Left and right; empty where no file tells.
        messages: Those of the readings, and what had to be assumed.
    """

    device: PoseStream
    head: PoseStream
    camera: PoseStream
    gaze: GazeStream
    wrists: tuple[HandStream, ...]
    messages: tuple[str, ...]


def mps_streams(
    readings: mps.MpsReadings, *, world_from_source: Float[np.ndarray, "4 4"], least_confidence: float = 0.0
) -> MpsStreams:
    """Return the poses of glasses, eyes and camera, gaze rays and wrists.

    A pose is invalid where its quality is below 0.5; steps above 50 ms are gaps that neither gaze nor wrists bridge.

    Args:
        readings: Whole or thinned; the gaze rays are the same either way.
        world_from_source: Rigid transform from the trajectory's world.
        least_confidence: A wrist is valid where its confidence is above this.
    """
    trajectory = readings.trajectory
    turn = Rotation.from_matrix(world_from_source[:3, :3])
    position = trajectory.position @ world_from_source[:3, :3].T + world_from_source[:3, 3]
    rotation = (turn * Rotation.from_quat(trajectory.rotation, scalar_first=True)).as_quat(scalar_first=True)
    device = PoseStream(trajectory.time_us / 1e6, position, rotation, trajectory.quality >= mps.LEAST_QUALITY)
    head, camera = head_and_camera(device, readings.glasses_size or ASSUMED_SIZE, readings.device_from_rgb)
    gaze = gaze_in_world(head, readings.gaze, same_instant=SAME_INSTANT)
    wrists = []
    if readings.wrists is not None:
        times = readings.wrists.time_us / 1e6
        origin, facing = device.pose_at(times)
        world_from_device = Rotation.from_quat(facing, scalar_first=True)
        posed = covered(device.times, device.valid, times, max_gap=mps.LONGEST_POSE_STEP, tolerance=SAME_INSTANT)
        for index, side in enumerate(SIDES):
            local = readings.wrists.wrist[:, index]
            seen = np.isfinite(local).min(axis=1)
            points = world_from_device.apply(np.where(seen[:, None], local, 0.0)) + origin
            # Greater, not at least: 0 and -1 both stand for a hand that was not seen.
            valid = seen & posed & np.greater(readings.wrists.confidence[:, index], least_confidence)
            wrists.append(HandStream(side, "wrist", times, points[:, None], valid))
    # Tell the user where the glasses were not tracked.
    remarks = []
    steps = np.diff(device.times)
    gaps = steps[steps > mps.LONGEST_POSE_STEP + 1e-6]
    if gaps.size:
        remarks.append(f"gaps in the poses of the glasses, not bridged: {gaps.size}, the longest {gaps.max():.2f} s")
    outside = (gaze.times < device.times[0] - SAME_INSTANT) | (gaze.times > device.times[-1] + SAME_INSTANT)
    if outside.any():
        remarks.append(f"{int(outside.sum())} of {len(outside)} gaze rows lie outside the tracked time and are invalid")
    messages = (*readings.messages, *_remarks(readings, gaze), *remarks)
    return MpsStreams(device, head, camera, gaze, tuple(wrists), messages)


def head_and_camera(
    device: PoseStream, size: mps.GlassesSize, device_from_rgb: Float[np.ndarray, "4 4"] | None
) -> tuple[PoseStream, PoseStream]:
    """Return the world poses of the central pupil frame and of the RGB camera.

    Args:
        device: World poses of the glasses.
        size: Size of the glasses, which decides where the eyes are.
        device_from_rgb: Calibrated pose of the camera; its pose by design where None.
    """
    device_cpf = mps.device_from_cpf(size)
    device_rgb = device_cpf @ mps.cpf_from_rgb() if device_from_rgb is None else device_from_rgb
    return part_poses(device, device_cpf), part_poses(device, device_rgb)


def part_poses(device: PoseStream, device_from_part: Float[np.ndarray, "4 4"]) -> PoseStream:
    """Return the world poses of a part of the glasses (CPF, a camera) from those of the device."""
    rotation = Rotation.from_quat(device.rotation, scalar_first=True)
    position = device.position + rotation.apply(device_from_part[:3, 3])
    turned = rotation * Rotation.from_matrix(device_from_part[:3, :3])
    return PoseStream(device.times, position, turned.as_quat(scalar_first=True), device.valid)


def gaze_in_world(cpf: PoseStream, angles: mps.GazeAngles, *, same_instant: float) -> GazeStream:
    """Return the gaze rays in the world: origin = CPF origin, direction = rotated ``normalise(tan yaw, tan pitch, 1)``.

    A ray is invalid when an angle is not finite or beyond 60 degrees, or when no valid pose lies within
    ``same_instant`` and none on both sides at most 50 ms apart.

    Args:
        cpf: World poses of the central pupil frame.
        angles: Yaw is positive left, pitch positive up, and both may hold NaN.
        same_instant: Rows closer than this belong to one instant, seconds.
    """
    times = angles.time_us / 1e6
    yaw, pitch = angles.yaw, angles.pitch
    with np.errstate(invalid="ignore"):
        measured = (np.abs(yaw) <= WIDEST_GAZE_ANGLE) & (np.abs(pitch) <= WIDEST_GAZE_ANGLE)
    # Streams hold no NaN: an unmeasured ray looks straight ahead, and the mask says so.
    direction_cpf = gaze_directions_cpf(np.where(measured, yaw, 0.0), np.where(measured, pitch, 0.0))
    origin, rotation = cpf.pose_at(times)
    posed = covered(cpf.times, cpf.valid, times, max_gap=LONGEST_POSE_STEP, tolerance=same_instant)
    direction = Rotation.from_quat(rotation, scalar_first=True).apply(direction_cpf)
    return GazeStream(times, origin, direction, measured & posed)


def _remarks(readings: mps.MpsReadings, gaze: GazeStream) -> tuple[str, ...]:
    remarks = size_remark(readings.glasses_size, ASSUMED_SIZE)
    if readings.gaze_kind == "general":
        remarks.append("general gaze, without the wearer's own calibration: directions may be off by several degrees")
    if not gaze.valid.any():
        remarks.append("no gaze row has a direction and a pose of the glasses: nothing can be primed")
    if low := int((readings.trajectory.quality < mps.LEAST_QUALITY).sum()):
        said = f"{low} of {len(readings.trajectory.quality)} poses of the glasses that were read have a quality below"
        remarks.append(f"{said} {mps.LEAST_QUALITY} and are invalid")
    return tuple(remarks)


def size_remark(size: mps.GlassesSize | None, assumed: mps.GlassesSize) -> list[str]:
    """Tell the user that a size of the glasses had to be assumed; nothing where a file tells it."""
    if size is not None:
        return []
    return [f"size of the glasses unknown, {assumed} assumed: gaze origins may be off by 2.4 mm"]
