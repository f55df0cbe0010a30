"""Online calibration of the Machine Perception Services: where the cameras sit on the glasses.

Source: docs/specification/aria-mps.md#device-frame-and-cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.limits import LONGEST_LINE
from prbench.readers.aria_mps import format as mps
from prbench.readers.files import require_poses
from prbench.readers.zipped import Source, opened, shown


class _Translation(msgspec.Struct):
    translation: tuple[float, float, float] = msgspec.field(name="Translation")
    quaternion: tuple[float, tuple[float, float, float]] = msgspec.field(name="UnitQuaternion")


class _Camera(msgspec.Struct):
    label: str = msgspec.field(name="Label")
    pose: _Translation = msgspec.field(name="T_Device_Camera")


class _CalibrationRow(msgspec.Struct):
    tracking_timestamp_us: int
    cameras: tuple[_Camera, ...] = msgspec.field(name="CameraCalibrations")


@dataclass(frozen=True)
class OnlineCalibration:
    """Where the cameras sit on the glasses, at one instant."""

    time_us: int
    device_from_camera: dict[str, Float[np.ndarray, "4 4"]]
    """By label: ``camera-slam-left``, ``camera-slam-right``, ``camera-rgb``."""

    @property
    def slam_baseline(self) -> float:
        """Distance between the two SLAM cameras, metres; it tells the size of the glasses."""
        left, right = (self.device_from_camera[f"camera-slam-{side}"] for side in ("left", "right"))
        return float(np.linalg.norm(left[:3, 3] - right[:3, 3]))

    @property
    def size(self) -> mps.GlassesSize:
        """Size of the glasses."""
        return mps.glasses_size(self.slam_baseline)


def read_first_calibration(path: Source) -> OnlineCalibration:
    """Read the first record of ``online_calibration.jsonl``; later ones differ by fractions of a millimetre.

    Raises:
        InputFileError: if the file is missing or empty, or its first line is no calibration of the three cameras.
    """
    try:
        with opened(path) as file:
            row = msgspec.json.decode(file.readline(LONGEST_LINE), type=_CalibrationRow)
    except (FileNotFoundError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputFileError(shown(path), "line 1", expected="a calibration record", found=str(error)) from error
    for camera in row.cameras:
        quaternion = np.array([(camera.pose.quaternion[0], *camera.pose.quaternion[1])])
        require_poses(path, np.array([camera.pose.translation]), quaternion)
    poses = {camera.label: _transform(camera.pose) for camera in row.cameras}
    missing = {"camera-slam-left", "camera-slam-right", "camera-rgb"} - poses.keys()
    if missing:
        raise InputFileError(
            shown(path), "line 1", expected=f"the camera {min(missing)}", found=", ".join(sorted(poses))
        )
    return OnlineCalibration(row.tracking_timestamp_us, poses)


def _transform(pose: _Translation) -> np.ndarray:
    transform = np.eye(4)
    quaternion = (pose.quaternion[0], *pose.quaternion[1])
    transform[:3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    transform[:3, 3] = pose.translation
    return transform
