"""The intermediate data: poses and gaze a video frame, instead of MPS files.

Source: docs/specification/hd-epic.md#intermediate-data.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.readers.aria_mps.format import GlassesSize
from prbench.readers.files import Nanoseconds, decode_json, text_lines
from prbench.readers.hd_epic import format as hd_epic

_NO_TIME = -1
_SIZES: dict[str, GlassesSize] = {"DVT-S": "DVT-S", "DVT-L": "DVT-L"}
_ROTATION_TOLERANCE = 1e-3


class _Frame(msgspec.Struct):
    frame_index: int
    tracking_timestamp_ns: Nanoseconds
    slam_timestamp_ns: Nanoseconds | None = None
    gaze_timestamp_ns: Nanoseconds | None = None
    pose: tuple[tuple[float, float, float, float], ...] | None = msgspec.field(name="T_world_device", default=None)
    gaze: tuple[float, float, float] | None = msgspec.field(name="gaze_direction_in_world", default=None)


class _Camera(msgspec.Struct):
    projection_params: list[float] = []
    image_size: tuple[float, float] | None = None
    pose: list[list[float]] | None = msgspec.field(name="T_device_camera", default=None)


class _Calibration(msgspec.Struct):
    device_subtype: str | None = None
    cameras: dict[str, _Camera] = {}


_FRAME = msgspec.json.Decoder(_Frame)
_CALIBRATION = msgspec.json.Decoder(_Calibration)


def read_frames(path: Path, calibration: Path | None) -> hd_epic.FrameReadings:
    """Read ``framewise_info.jsonl`` and, where it is there, the glasses' calibration beside it.

    Raises:
        InputFileError: if a file is missing or damaged, a frame is missing, or a pose is none.
    """
    frames = _decoded_lines(path)
    for number, frame in enumerate(frames):
        if frame.frame_index != number:
            raise InputFileError(
                path, f"line {number + 1}", expected=f"frame_index {number}", found=str(frame.frame_index)
            )
    poses = np.array([_pose_rows(frame, path) for frame in frames]).reshape(-1, 3, 4)
    _require_rotations(path, poses)
    size, device_from_rgb, focal = _read_calibration(calibration)
    return hd_epic.FrameReadings(
        tracking_ns=np.array([frame.tracking_timestamp_ns for frame in frames], dtype=np.int64),
        slam_ns=_times([None if frame.pose is None else frame.slam_timestamp_ns for frame in frames]),
        gaze_ns=_times([frame.gaze_timestamp_ns for frame in frames]),
        world_from_device=poses,
        gaze_direction=np.array([frame.gaze or (np.nan,) * 3 for frame in frames], dtype=np.float64),
        glasses_size=size,
        device_from_rgb=device_from_rgb,
        rgb_focal_length=focal,
    )


def _decoded_lines(path: Path) -> list[_Frame]:
    frames: list[_Frame] = []
    for number, line in text_lines(path):
        try:
            frames.append(_FRAME.decode(line))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise InputFileError(
                path,
                f"line {number}",
                expected="one video frame as JSON",
                found=str(error),
                remedy="The file may be truncated; copy or download it again.",
            ) from error
    if not frames:
        raise InputFileError(path, "", expected="one line a video frame", found="no line")
    return frames


def _pose_rows(frame: _Frame, path: Path) -> Float[np.ndarray, "3 4"]:
    if frame.pose is None:
        return np.full((3, 4), np.nan)
    if len(frame.pose) < 3:
        raise InputFileError(
            path,
            f"frame {frame.frame_index}, T_world_device",
            expected="3 rows of 4 numbers",
            found=f"{len(frame.pose)} rows",
        )
    return np.array(frame.pose[:3], dtype=np.float64)


def _require_rotations(path: Path, poses: Float[np.ndarray, "n 3 4"]) -> None:
    posed = np.isfinite(poses).all(axis=(1, 2))
    rotation = poses[posed, :, :3]
    error = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(error > _ROTATION_TOLERANCE)
    if bad.size:
        frame = int(np.flatnonzero(posed)[bad[0]])
        raise InputFileError(path, f"frame {frame}, T_world_device", expected="a rotation", found="another matrix")


def _times(values: list[int | None]) -> Int[np.ndarray, " n"]:
    return np.array([_NO_TIME if value is None else value for value in values], dtype=np.int64)


def _read_calibration(
    path: Path | None,
) -> tuple[GlassesSize | None, Float[np.ndarray, "4 4"] | None, float | None]:
    """Size of the glasses, pose and focal length (pixels of the 1408 image) of the RGB camera, as far as told."""
    if path is None:
        return None, None, None
    calibration = decode_json(path, _CALIBRATION)
    camera = calibration.cameras.get("camera-rgb")
    size = _SIZES.get(calibration.device_subtype or "")
    if camera is None or camera.pose is None:
        return size, None, None
    if len(camera.pose) < 3 or any(len(row) != 4 for row in camera.pose):
        found = f"rows of {sorted({len(row) for row in camera.pose})} numbers"
        raise InputFileError(path, "camera-rgb, T_device_camera", expected="3 rows of 4 numbers", found=found)
    transform = np.eye(4)
    transform[:3] = np.array(camera.pose[:3], dtype=np.float64)
    focal = None
    if camera.projection_params and camera.image_size and camera.image_size[0] > 0:
        focal = camera.projection_params[0] * hd_epic.IMAGE_SIZE / camera.image_size[0]
    return size, transform, focal
