"""Files of one HD-EPIC video besides MPS: movements with their masks, published priming, frame times, poses by frame.

The annotation files hold all 156 videos (tens of megabytes). Each is opened once a process; a video's part of it stays
text until that video is read.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.limits import MOST_FRAMES
from prbench.readers.aria_mps.format import GlassesSize
from prbench.readers.files import Nanoseconds, decode_json, missing_file, read_columns, text_lines
from prbench.readers.hd_epic import format as hd_epic

_Frame = Annotated[int, msgspec.Meta(ge=-MOST_FRAMES, le=MOST_FRAMES)]
"""Number of a video frame; negative ones are marks."""


class _Track(msgspec.Struct):
    track_id: str
    time_segment: tuple[float, float]
    masks: list[str] = []


class _Association(msgspec.Struct):
    name: str
    tracks: list[_Track]


class _Mask(msgspec.Struct):
    frame_number: _Frame
    location: list[float | None] | None = msgspec.field(name="3d_location", default=None)
    bbox: list[float] | None = None
    fixture: str | None = None


class _PrimeStats(msgspec.Struct):
    frame_primed: _Frame


class _Side(msgspec.Struct):
    frame: _Frame
    prime_stats: _PrimeStats
    location: list[float | None] | None = msgspec.field(name="3d_location", default=None)


class _PrimedObject(msgspec.Struct):
    start: _Side | None = None
    end: _Side | None = None


_VIDEOS = msgspec.json.Decoder(dict[str, msgspec.Raw])
_ASSOCIATIONS = msgspec.json.Decoder(dict[str, _Association])
_MASKS = msgspec.json.Decoder(dict[str, _Mask])
_PRIMING = msgspec.json.Decoder(dict[str, _PrimedObject])


def read_tracks(associations: Path, masks: Path, video: str) -> tuple[tuple[hd_epic.ObjectTrack, ...], tuple[str, ...]]:
    """All movements of one video in the order of time, and remarks.

    Objects may have tracks out of order or overlapping in time: they are sorted, and stay apart.

    Args:
        associations: ``assoc_info.json``.
        masks: ``mask_info.json``.
        video: Its name.

    Raises:
        InputFileError: if a file is missing or damaged, or the first one does not know the video.
    """
    entry = _entry(associations, video)
    if entry is None:
        raise InputFileError(
            associations,
            video,
            expected="the movements of this video",
            found="no such key",
            remedy="Update the annotation repository, or leave the video out with --recordings.",
        )
    objects = _decoded(_ASSOCIATIONS, entry, associations, video)
    known = _video_masks(masks, video)
    tracks = [
        hd_epic.ObjectTrack(
            track_id=track.track_id,
            object_id=key,
            name=association.name,
            start=_seconds(track.time_segment[0], associations, video, track.track_id),
            end=_seconds(track.time_segment[1], associations, video, track.track_id),
            masks=tuple(known[mask] for mask in track.masks if mask in known),
        )
        for key, association in objects.items()
        for track in association.tracks
    ]
    # Names decide between equal times, so that the order of the file leaves no trace.
    tracks.sort(key=lambda track: (track.start, track.end, track.object_id, track.track_id))
    named = [mask for association in objects.values() for track in association.tracks for mask in track.masks]
    missing = sum(mask not in known for mask in named)
    return tuple(tracks), (
        (f"{missing} of {len(named)} masks of the tracks are not in {masks.name}",) if missing else ()
    )


def _entry(path: Path, video: str) -> msgspec.Raw | None:
    try:
        status = path.stat()
    except OSError as error:
        raise missing_file(path) from error
    return _videos(path, status.st_size, status.st_mtime_ns).get(video)


@lru_cache(maxsize=8)
def _videos(path: Path, _size: int, _changed_ns: int) -> dict[str, msgspec.Raw]:
    """The file cut into its videos, none of them parsed; opened anew when it has changed."""
    return decode_json(path, _VIDEOS)


def _decoded(decoder: msgspec.json.Decoder, entry: msgspec.Raw, path: Path, video: str):
    try:
        return decoder.decode(entry)
    except msgspec.DecodeError as error:
        raise InputFileError(
            path, video, expected="the keys of this format", found=str(error), remedy="Download the file again."
        ) from error


def _video_masks(path: Path, video: str) -> dict[str, hd_epic.ObjectMask]:
    entry = _entry(path, video)
    if entry is None:
        return {}
    return {
        key: hd_epic.ObjectMask(
            mask_id=key,
            frame=mask.frame_number,
            location=_numbers(mask.location, 3),
            box_px=_numbers(mask.bbox, 4),
            fixture=None if mask.fixture in (None, hd_epic.NO_FIXTURE) else mask.fixture,
        )
        for key, mask in _decoded(_MASKS, entry, path, video).items()
    }


def _numbers(values: list[float | None] | list[float] | None, count: int) -> Float[np.ndarray, " k"] | None:
    """So many finite numbers, or None."""
    if values is None or len(values) != count or any(value is None for value in values):
        return None
    array = np.array(values, dtype=np.float64)
    return array if np.isfinite(array).all() else None


def _seconds(value: float, path: Path, video: str, track: str) -> float:
    if not np.isfinite(value):
        raise InputFileError(path, f"{video}, track {track}", expected="times in seconds", found=str(value))
    return value


def read_priming(path: Path, video: str) -> tuple[hd_epic.PublishedSide, ...]:
    """Read the dataset's own priming results of one video; none for a video that the file does not know.

    Raises:
        InputFileError: if the file is missing or damaged.
    """
    entry = _entry(path, video)
    if entry is None:
        return ()
    sides = [
        (f"{key}/{name}", name == "start", side)
        for key, primed in _decoded(_PRIMING, entry, path, video).items()
        for name, side in (("start", primed.start), ("end", primed.end))
        if side is not None
    ]
    return tuple(
        hd_epic.PublishedSide(key, is_start, side.frame, _numbers(side.location, 3), side.prime_stats.frame_primed)
        for key, is_start, side in sides
    )


class _Log(msgspec.Struct):
    num_mp4_frames: int | None = None


_LOG = msgspec.json.Decoder(_Log)
_MAP = msgspec.json.Decoder(dict[str, str | int])


def read_video_clock(path: Path, log: Path | None) -> tuple[hd_epic.VideoClock, tuple[str, ...]]:
    """Row i of the time file is video frame i; times may repeat (image shown twice) and jump (image skipped).

    Args:
        path: ``<video>_mp4_to_vrs_time_ns.csv``.
        log: ``<video>_vrs_to_mp4_log.json``, which tells how many frames there should be; None if it is not there.

    Returns:
        The clock, and remarks.

    Raises:
        InputFileError: if the file is missing or damaged, empty, or a time runs backwards.
    """
    times = _device_times(path)
    if len(times) < 2:
        raise InputFileError(
            path, "", expected="one row a video frame", found=f"{len(times)} rows", remedy="Download the file again."
        )
    backwards = np.flatnonzero(np.diff(times) < 0)
    if backwards.size:
        row = int(backwards[0]) + 1
        raise InputFileError(
            path,
            f"line {row + 2}",
            expected=f"a device time not before {times[row - 1]} ns",
            found=f"{times[row]} ns",
            remedy="Download the file again.",
        )
    frames = None if log is None else decode_json(log, _LOG).num_mp4_frames
    if frames is None or frames == len(times):
        return hd_epic.VideoClock(times), ()
    remark = f"{path.name} has {len(times)} rows for a video of {frames} frames: it may be truncated"
    return hd_epic.VideoClock(times), (remark,)


def _device_times(path: Path) -> Int[np.ndarray, " n"]:
    """Nanoseconds; some writers give them a decimal point."""
    try:
        return read_columns(path, {hd_epic.DEVICE_TIME: int})[hd_epic.DEVICE_TIME].to_numpy()
    except InputFileError as error:
        if not path.is_file():
            raise
        times = read_columns(path, {hd_epic.DEVICE_TIME: float})[hd_epic.DEVICE_TIME].to_numpy()
        if not np.isfinite(times).all():
            raise error
        return np.rint(times).astype(np.int64)


def slam_number(path: Path) -> dict[str, str]:
    """Number of the archive by name of the video; keys of the file are ``P01/<video>.vrs``.

    Raises:
        InputFileError: if the file is missing or damaged.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise missing_file(path) from error
    return _slam_numbers(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=32)
def _slam_numbers(path: Path, _size: int, _changed_ns: int) -> dict[str, str]:
    entries = decode_json(path, _MAP)
    return {key.rpartition("/")[2].removesuffix(".vrs"): str(number) for key, number in entries.items()}


_NO_TIME = -1
_SIZES: dict[str, GlassesSize] = {"DVT-S": "DVT-S", "DVT-L": "DVT-L"}
_ROTATION_TOLERANCE = 1e-3


class _FrameRow(msgspec.Struct):
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


_FRAME = msgspec.json.Decoder(_FrameRow)
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


def _decoded_lines(path: Path) -> list[_FrameRow]:
    frames: list[_FrameRow] = []
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


def _pose_rows(frame: _FrameRow, path: Path) -> Float[np.ndarray, "3 4"]:
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
