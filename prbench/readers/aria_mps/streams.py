"""From what Aria glasses say to streams in the world.

Sources: docs/specification/aria-mps.md#device-frame-and-cameras and docs/specification/aria-mps.md#eye-gaze.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.readers.aria_mps.format import LONGEST_POSE_STEP, WIDEST_GAZE_ANGLE, gaze_directions_cpf
from prbench.recording.streams import GazeStream, PoseStream
from prbench.timelines import covered, interpolate, slerp


def part_poses(device: PoseStream, device_from_part: Float[np.ndarray, "4 4"]) -> PoseStream:
    """World poses of a part of the glasses (CPF, a camera) from those of the device."""
    rotation = Rotation.from_quat(device.rotation, scalar_first=True)
    return PoseStream(
        times=device.times,
        position=device.position + rotation.apply(device_from_part[:3, 3]),
        rotation=(rotation * Rotation.from_matrix(device_from_part[:3, :3])).as_quat(scalar_first=True),
        valid=device.valid,
    )


def gaze_in_world(
    cpf: PoseStream,
    times: Float[np.ndarray, " n"],
    yaw: Float[np.ndarray, " n"],
    pitch: Float[np.ndarray, " n"],
    *,
    same_instant: float,
) -> GazeStream:
    """Gaze rays in the world: origin = CPF origin, direction = rotated ``normalise(tan yaw, tan pitch, 1)``.

    A ray is invalid when an angle is not finite or beyond 60 degrees, or when no valid pose lies within
    ``same_instant`` and none on both sides at most 50 ms apart.

    Args:
        cpf: World poses of the central pupil frame.
        times: Gaze times on the clock of the poses, seconds.
        yaw: Radians, positive left; may hold NaN.
        pitch: Radians, positive up; may hold NaN.
        same_instant: Rows closer than this belong to one instant, seconds.
    """
    with np.errstate(invalid="ignore"):
        measured = (np.abs(yaw) <= WIDEST_GAZE_ANGLE) & (np.abs(pitch) <= WIDEST_GAZE_ANGLE)
    direction_cpf = gaze_directions_cpf(np.where(measured, yaw, 0.0), np.where(measured, pitch, 0.0))
    usable = cpf.valid if cpf.valid.any() else np.ones_like(cpf.valid)
    rotation = slerp(cpf.times[usable], cpf.rotation[usable], times)
    posed = covered(cpf.times, cpf.valid, times, max_gap=LONGEST_POSE_STEP, tolerance=same_instant)
    return GazeStream(
        times=times,
        origin=interpolate(cpf.times[usable], cpf.position[usable], times),
        direction=Rotation.from_quat(rotation, scalar_first=True).apply(direction_cpf),
        valid=measured & posed,
    )
