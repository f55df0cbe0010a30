"""Files of one HD-EPIC video besides MPS: movements with their masks, published priming, and frame times.

The annotation files hold all 156 videos (tens of megabytes). Each is opened once a process; a video's part of it stays
text until that video is read.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import require, require_rows
from prbench.limits import LONGEST_RECORDING, MOST_FRAMES
from prbench.readers import AnnotationCounts
from prbench.readers.files import Metres, decode_json, must_exist, read_columns, read_entries
from prbench.readers.hd_epic import format as hd_epic
from prbench.recording import UnreadableEntry, named_entries

# Number of a video frame; some writers give it a decimal point.
_Frame = Annotated[float, msgspec.Meta(ge=0, le=MOST_FRAMES, multiple_of=1)]
_Seconds = Annotated[float, msgspec.Meta(ge=-LONGEST_RECORDING, le=LONGEST_RECORDING)]
_Point = Annotated[list[Metres | None], msgspec.Meta(max_length=3)]
_AGAIN = "Download the file again."


class _Track(msgspec.Struct):
    track_id: str | int
    time_segment: tuple[_Seconds, _Seconds]
    masks: list[Any] | None = None

    def __post_init__(self) -> None:
        start, end = self.time_segment
        if end < start:
            raise ValueError(f"an end at {end} s before the start at {start} s")


class _Association(msgspec.Struct):
    tracks: list[msgspec.Raw]
    name: Any = None


class _Mask(msgspec.Struct):
    frame_number: _Frame
    location: _Point | None = msgspec.field(name="3d_location", default=None)


class _PrimeStats(msgspec.Struct):
    frame_primed: Annotated[float, msgspec.Meta(ge=hd_epic.EXCLUDED, le=MOST_FRAMES, multiple_of=1)]


class _Side(msgspec.Struct):
    frame: _Frame
    prime_stats: _PrimeStats
    location: _Point | None = msgspec.field(name="3d_location", default=None)


class _Log(msgspec.Struct):
    num_mp4_frames: Any = None


_ENTRIES = msgspec.json.Decoder(dict[str, msgspec.Raw])


def annotated_videos(associations: Path) -> tuple[str, ...]:
    """Return the names of the videos of which ``assoc_info.json`` lists movements, sorted.

    Raises:
        InputFileError: if the file is missing or no JSON.
    """
    return tuple(sorted(_videos_of(associations)))


@dataclass(frozen=True)
class Movements:
    """What the annotation files say about the movements of one video.

    Attributes:
        tracks: Movements, sorted by time.
        objects: Number of objects that move.
        masks: Number of masks that the tracks name, whether or not a file describes them.
        remarks: Remarks for the user.
        unreadable: Entries that cannot be read.
    """

    tracks: tuple[hd_epic.ObjectTrack, ...]
    objects: int
    masks: int
    remarks: tuple[str, ...]
    unreadable: tuple[UnreadableEntry, ...]


def read_tracks(associations: Path, masks: Path | None, video: str) -> Movements:
    """Read all movements of one video in the order of time.

    Objects may have tracks out of order or overlapping in time: they are sorted, and stay apart.

    Args:
        associations: ``assoc_info.json``.
        masks: ``mask_info.json``; None where it is not there, and no movement has a place.
        video: Its name.

    Raises:
        InputFileError: if a file is missing or no JSON, or the first one does not know the video.
    """
    objects, unreadable = _of_video(associations, video)
    if objects is None or unreadable:
        expected = "the movements of this video"
        found = unreadable[0].found if unreadable else "no such key"
        remedy = "Update the annotation repository, or leave the video out with --recordings."
        raise InputFileError(associations, video, expected=expected, found=found, remedy=remedy)
    listed, odd = ({}, []) if masks is None else _of_video(masks, video)
    unreadable += odd
    shown = {}
    if masks is not None:
        decode = msgspec.json.Decoder(_Mask).decode
        forms, odd = read_entries(masks, listed or {}, decode, "a mask with frame_number and 3d_location")
        unreadable += odd
        shown = {
            key: hd_epic.ObjectMask(key, int(mask.frame_number), _point(mask.location)) for key, mask in forms.items()
        }
    expected = "an object with its name and its list of tracks"
    named, odd = read_entries(associations, objects, msgspec.json.Decoder(_Association).decode, expected)
    unreadable += odd
    tracks = []
    n_masks = 0
    missing = 0
    for key, association in named.items():
        entries = {f"{key}/tracks[{number}]": raw for number, raw in enumerate(association.tracks)}
        expected = "a track with track_id, time_segment [start, end] in seconds and masks"
        movements, odd = read_entries(associations, entries, msgspec.json.Decoder(_Track).decode, expected)
        unreadable += odd
        name = association.name if isinstance(association.name, str) and association.name.strip() else key
        used: set[str] = set()
        for where, track in movements.items():
            track_id = str(track.track_id)
            if track_id in used:
                expected = "a track_id of its own"
                unreadable.append(UnreadableEntry(associations.name, where, expected, f"'{track_id}' again"))
                continue
            used.add(track_id)
            ids = [mask for mask in track.masks or () if isinstance(mask, str)]
            n_masks += len(track.masks or ())
            missing += len(track.masks or ()) - sum(mask in (listed or ()) for mask in ids)
            seen = tuple(shown[mask] for mask in ids if mask in shown)
            tracks.append(hd_epic.ObjectTrack(track_id, key, name, *track.time_segment, seen))
    # Names decide between equal times, so that the order of the file leaves no trace.
    tracks.sort(key=lambda track: (track.start, track.end, track.object_id, track.track_id))
    remarks = ()
    if masks is None:
        remarks = (f"no {hd_epic.MASKS_FILE}: no event has a place",)
    elif missing:
        remarks = (f"{missing} of {n_masks} masks of the tracks are not in {masks.name}",)
    return Movements(tuple(tracks), len(named), n_masks, remarks, tuple(unreadable))


def _of_video(path: Path, video: str) -> tuple[dict[str, msgspec.Raw] | None, list[UnreadableEntry]]:
    """Return what a file that holds all videos says of one, by key; None where it does not know the video."""
    entry = _videos_of(path).get(video)
    if entry is None:
        return None, []
    of_video, unreadable = read_entries(path, {video: entry}, _ENTRIES.decode, "an object with one key an entry")
    return of_video.get(video, {}), unreadable


def _videos_of(path: Path) -> dict[str, msgspec.Raw]:
    with must_exist(path):
        status = path.stat()
    return _videos(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=8)
def _videos(path: Path, _size: int, _changed_ns: int) -> dict[str, msgspec.Raw]:
    """Return the file cut into its videos, none of them parsed; opened anew when it has changed."""
    return decode_json(path, dict[str, msgspec.Raw])


def _point(values: list[float | None] | None) -> Float[np.ndarray, "3"] | None:
    """Return three numbers, or None."""
    if values is None or len(values) != 3 or None in values:
        return None
    return np.array(values, dtype=np.float64)


def read_priming(path: Path, video: str) -> tuple[tuple[hd_epic.PublishedSide, ...], tuple[UnreadableEntry, ...]]:
    """Read the dataset's own priming results of one video; none for a video that the file does not know.

    A side that is null, a text or empty is not there: nothing is published about it.

    Returns:
        The sides, and the entries that cannot be read.

    Raises:
        InputFileError: if the file is missing or no JSON.
    """
    objects, unreadable = _of_video(path, video)
    there = {key: raw for key, raw in (objects or {}).items() if not _is_empty(raw)}
    named, odd = read_entries(path, there, _ENTRIES.decode, "an object with the keys start and end")
    sides = {
        f"{key}/{name}": raw
        for key, entry in named.items()
        for name, raw in entry.items()
        if name in ("start", "end") and not _is_empty(raw)
    }
    expected = "frame, 3d_location and prime_stats with frame_primed"
    readable, odd_sides = read_entries(path, sides, msgspec.json.Decoder(_Side).decode, expected)
    published = (
        hd_epic.PublishedSide(
            key, key.endswith("/start"), int(side.frame), _point(side.location), int(side.prime_stats.frame_primed)
        )
        for key, side in readable.items()
    )
    return tuple(published), (*unreadable, *odd, *odd_sides)


def _is_empty(raw: msgspec.Raw) -> bool:
    """Return True for null, a text, and an empty object or list."""
    text = bytes(raw).translate(None, b" \t\r\n")
    return text.startswith(b'"') or text in (b"null", b"{}", b"[]")


def count_annotations(
    associations: Path, masks: Path | None, priming: Path | None, published: dict[str, dict[str, int]]
) -> AnnotationCounts:
    """Count the movements of all videos, and the published priming where its file is there.

    Raises:
        InputFileError: if a file is missing or no JSON.
    """
    people: dict[str, Counter[str]] = {}
    outcomes: dict[str, Counter[str]] = {"pick": Counter(), "put": Counter()}
    unreadable: list[UnreadableEntry] = []
    repeated = 0
    described = 0
    placed = 0
    examples: list[str] = []
    for video in annotated_videos(associations):
        own = people.setdefault(participant_of(video), Counter())
        own["videos"] += 1
        try:
            movements = read_tracks(associations, masks, video)
        except InputFileError as error:
            unreadable.append(UnreadableEntry(associations.name, video, error.expected, error.found))
            continue
        unreadable += movements.unreadable
        moved = len(movements.tracks)
        described += sum(len(track.masks) for track in movements.tracks)
        placed += sum(mask.location is not None for track in movements.tracks for mask in track.masks)
        for track in movements.tracks[:1]:
            examples.append(f"{video}: {track.name} lifted at {track.start:.2f} s, put down at {track.end:.2f} s")
        starts = {(track.object_id, track.start) for track in movements.tracks}
        repeated += 2 * moved - len(starts) - len({(track.object_id, track.end) for track in movements.tracks})
        own.update(objects=movements.objects, picks=moved, puts=moved, masks=movements.masks)
        if priming is not None:
            sides, odd = read_priming(priming, video)
            unreadable += odd
            own["primed"] += sum(side.frame_primed >= 0 for side in sides)
            for side in sides:
                told = {hd_epic.NOT_PRIMED: "not_primed", hd_epic.EXCLUDED: "excluded"}
                outcomes["pick" if side.is_start else "put"][told.get(side.frame_primed, "primed")] += 1
    remarks = ["masks tell no hand: the hand of an event needs SLAM, wrists or a body"]
    if repeated:
        remarks.append(f"{repeated} picks and puts are listed twice, with equal object and time: a table has each once")
    if masks is not None:
        remarks.append(f"{described:,} of the masks stand in {masks.name}, {placed:,} of them with a place")
    else:
        remarks.append(f"{hd_epic.MASKS_FILE} is not there: masks are those that the movements name, and have no place")
    if unreadable:
        remarks.append(named_entries(unreadable))
    by_participant = {person: dict(own) for person, own in sorted(people.items())}
    totals = dict(sum(people.values(), Counter())) | {"participants": len(people)}
    priming_counts = {action: dict(own) for action, own in outcomes.items()} if priming is not None else {}
    told = (tuple(unreadable), tuple(remarks), tuple(examples))
    return AnnotationCounts(totals, by_participant, published, priming_counts, *told)


def participant_of(video: str) -> str:
    """Return the participant that a video's name begins with."""
    return video.partition("-")[0]


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
    frames = None if log is None else decode_json(log, _Log).num_mp4_frames
    if not isinstance(frames, int | float) or frames == len(times):
        return hd_epic.VideoClock(times), ()
    remark = f"{path.name} has {len(times)} rows for a video of {frames} frames: it may be truncated"
    return hd_epic.VideoClock(times), (remark,)


def slam_number(path: Path) -> dict[str, str]:
    """Return the number of the archive by name of the video; keys of the file are ``P01/<video>.vrs``.

    A video whose entry is no number has none.

    Raises:
        InputFileError: if the file is missing or damaged.
    """
    numbers = {key: str(value).removesuffix(".0") for key, value in decode_json(path, dict[str, Any]).items()}
    return {key.rpartition("/")[2].removesuffix(".vrs"): text for key, text in numbers.items() if text.isdecimal()}
