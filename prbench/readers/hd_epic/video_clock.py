"""Read the instants of an HD-EPIC video's frames, and the name of the map in which its glasses were followed."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Int

from prbench.errors import InputFileError
from prbench.readers.files import decode_json, missing_file, read_columns
from prbench.readers.hd_epic import format as hd_epic


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
    return _numbers(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=32)
def _numbers(path: Path, _size: int, _changed_ns: int) -> dict[str, str]:
    entries = decode_json(path, _MAP)
    return {key.rpartition("/")[2].removesuffix(".vrs"): str(number) for key, number in entries.items()}
