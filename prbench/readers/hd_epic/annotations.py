"""Annotations of HD-EPIC: movements of objects with their masks, and the published priming results.

The files hold all 156 videos (tens of megabytes). Each is opened once a process; a video's part of it stays text until
that video is read.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.limits import MOST_FRAMES
from prbench.readers.files import decode_json, missing_file
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
    return tuple(tracks), _remarks(objects, known, masks)


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


def _remarks(
    associations: dict[str, _Association], known: dict[str, hd_epic.ObjectMask], masks: Path
) -> tuple[str, ...]:
    named = [mask for association in associations.values() for track in association.tracks for mask in track.masks]
    missing = sum(mask not in known for mask in named)
    return (f"{missing} of {len(named)} masks of the tracks are not in {masks.name}",) if missing else ()


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
