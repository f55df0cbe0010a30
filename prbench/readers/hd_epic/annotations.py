"""Files of one HD-EPIC video besides MPS: movements with their masks, published priming, and frame times.

The annotation files hold all 156 videos (tens of megabytes). Each is opened once a process; a video's part of it stays
text until that video is read.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import require, require_rows
from prbench.limits import MOST_FRAMES
from prbench.readers.files import decode_json, must_exist, read_columns
from prbench.readers.hd_epic import format as hd_epic

# Number of a video frame; negative ones are marks.
_Frame = Annotated[int, msgspec.Meta(ge=-MOST_FRAMES, le=MOST_FRAMES)]
_AGAIN = "Download the file again."


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


class _Log(msgspec.Struct):
    num_mp4_frames: int | None = None


_VIDEOS = msgspec.json.Decoder(dict[str, msgspec.Raw])
_ASSOCIATIONS = msgspec.json.Decoder(dict[str, _Association])
_MASKS = msgspec.json.Decoder(dict[str, _Mask])
_PRIMING = msgspec.json.Decoder(dict[str, _PrimedObject])
_LOG = msgspec.json.Decoder(_Log)
_MAP = msgspec.json.Decoder(dict[str, str | int])


def read_tracks(associations: Path, masks: Path, video: str) -> tuple[tuple[hd_epic.ObjectTrack, ...], tuple[str, ...]]:
    """Read all movements of one video in the order of time, and remarks.

    Objects may have tracks out of order or overlapping in time: they are sorted, and stay apart.

    Args:
        associations: ``assoc_info.json``.
        masks: ``mask_info.json``.
        video: Its name.

    Raises:
        InputFileError: if a file is missing or damaged, or the first one does not know the video.
    """
    objects: dict[str, _Association] | None = _decoded(_ASSOCIATIONS, associations, video)
    if objects is None:
        expected = "the movements of this video"
        remedy = "Update the annotation repository, or leave the video out with --recordings."
        raise InputFileError(associations, video, expected=expected, found="no such key", remedy=remedy)
    known = {
        key: hd_epic.ObjectMask(
            mask_id=key,
            frame=mask.frame_number,
            location=_numbers(mask.location, 3),
            box_px=_numbers(mask.bbox, 4),
            fixture=None if mask.fixture in (None, hd_epic.NO_FIXTURE) else mask.fixture,
        )
        for key, mask in (_decoded(_MASKS, masks, video) or {}).items()
    }
    tracks = []
    missing = 0
    named = 0
    for key, association in objects.items():
        for track in association.tracks:
            start, end = track.time_segment
            where = f"{video}, track {track.track_id}"
            finite = bool(np.isfinite(track.time_segment).all())
            require(associations, (finite, where, "times in seconds", f"{start} to {end}", ""))
            shown = tuple(known[mask] for mask in track.masks if mask in known)
            named += len(track.masks)
            missing += len(track.masks) - len(shown)
            tracks.append(hd_epic.ObjectTrack(track.track_id, key, association.name, start, end, shown))
    # Names decide between equal times, so that the order of the file leaves no trace.
    tracks.sort(key=lambda track: (track.start, track.end, track.object_id, track.track_id))
    remark = f"{missing} of {named} masks of the tracks are not in {masks.name}"
    return tuple(tracks), (remark,) if missing else ()


def _decoded(decoder: msgspec.json.Decoder, path: Path, video: str):
    """Return the part of one video of a file that holds all; None where it does not know the video."""
    with must_exist(path):
        status = path.stat()
    entry = _videos(path, status.st_size, status.st_mtime_ns).get(video)
    try:
        return None if entry is None else decoder.decode(entry)
    except msgspec.DecodeError as error:
        expected = "the keys of this format"
        raise InputFileError(path, video, expected=expected, found=str(error), remedy=_AGAIN) from error


@lru_cache(maxsize=8)
def _videos(path: Path, _size: int, _changed_ns: int) -> dict[str, msgspec.Raw]:
    """Return the file cut into its videos, none of them parsed; opened anew when it has changed."""
    return decode_json(path, _VIDEOS)


def _numbers(values: list[float | None] | list[float] | None, count: int) -> Float[np.ndarray, " k"] | None:
    """Return so many finite numbers, or None."""
    if values is None or len(values) != count or any(value is None for value in values):
        return None
    array = np.array(values, dtype=np.float64)
    return array if np.isfinite(array).all() else None


def read_priming(path: Path, video: str) -> tuple[hd_epic.PublishedSide, ...]:
    """Read the dataset's own priming results of one video; none for a video that the file does not know.

    Raises:
        InputFileError: if the file is missing or damaged.
    """
    objects: dict[str, _PrimedObject] = _decoded(_PRIMING, path, video) or {}
    return tuple(
        hd_epic.PublishedSide(
            f"{key}/{name}", name == "start", side.frame, _numbers(side.location, 3), side.prime_stats.frame_primed
        )
        for key, primed in objects.items()
        for name, side in (("start", primed.start), ("end", primed.end))
        if side is not None
    )


def read_video_clock(path: Path, log: Path | None) -> tuple[hd_epic.VideoClock, tuple[str, ...]]:
    """Read the device time of every video frame; times may repeat (image shown twice) and jump (image skipped).

    Args:
        path: ``<video>_mp4_to_vrs_time_ns.csv``, in nanoseconds; some writers give them a decimal point.
        log: ``<video>_vrs_to_mp4_log.json``, which tells how many frames there should be; None if it is not there.

    Returns:
        The clock, and remarks.

    Raises:
        InputFileError: if the file is missing or damaged, empty, or a time runs backwards.
    """
    try:
        times = read_columns(path, {hd_epic.DEVICE_TIME: int})[hd_epic.DEVICE_TIME].to_numpy()
    except InputFileError as error:
        if not path.is_file():
            raise
        decimal = read_columns(path, {hd_epic.DEVICE_TIME: float})[hd_epic.DEVICE_TIME].to_numpy()
        if not np.isfinite(decimal).all():
            raise error
        times = np.rint(decimal).astype(np.int64)
    require(path, (len(times) >= 2, "", "one row a video frame", f"{len(times)} rows", _AGAIN))
    require_rows(
        path,
        np.diff(times) < 0,
        lambda row: f"a device time not before {times[row]} ns",
        lambda row: f"{times[row + 1]} ns",
        first=3,
        remedy=_AGAIN,
    )
    frames = None if log is None else decode_json(log, _LOG).num_mp4_frames
    if frames is None or frames == len(times):
        return hd_epic.VideoClock(times), ()
    remark = f"{path.name} has {len(times)} rows for a video of {frames} frames: it may be truncated"
    return hd_epic.VideoClock(times), (remark,)


def slam_number(path: Path) -> dict[str, str]:
    """Return the number of the archive by name of the video; keys of the file are ``P01/<video>.vrs``.

    Raises:
        InputFileError: if the file is missing or damaged.
    """
    entries = decode_json(path, _MAP)
    return {key.rpartition("/")[2].removesuffix(".vrs"): str(number) for key, number in entries.items()}
