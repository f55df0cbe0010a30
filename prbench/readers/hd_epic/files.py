"""Find and read the files of HD-EPIC videos, zipped or not (docs/specification/hd-epic.md#folder-tree)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

import prbench.readers.hd_epic.annotations as annotating  # `from` would find Python's own feature of that name
from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import require
from prbench.readers import ReaderOptions, read_synthetic_tree
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import UNREADABLE, find_mps_files, read_mps, require_up
from prbench.readers.aria_mps.to_recording import mps_streams
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.egoallo.files import body_extent, find_outputs
from prbench.readers.egoallo.to_recording import NO_OUTPUTS
from prbench.readers.extents import SEVERAL_SENSORS, Extent, can_be_looked_at, csv_extent
from prbench.readers.found import InputFile, RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.three_point import find_body
from prbench.recording import Recording


class HdEpicOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the reader; see the fields.

    Attributes:
        annotations: The annotation repository, where it does not lie beside the data.
        poses: Source of bodies: EgoAllo, or the files of `prbench poses three-point`.
        smplh_model: The licensed SMPL-H ``model.npz`` that turns EgoAllo's outputs into joints.
        poses_root: Folder of EgoAllo's outputs by video, where it is not ``egoallo`` below the root.
        events_only: List picks and puts from the annotations alone, on the video's own clock.
    """

    annotations: Path | None = None
    poses: Literal["egoallo", "three-point"] = "egoallo"
    smplh_model: Path | None = None
    poses_root: Path | None = None
    events_only: bool = False


# Roles of the files of a video, beside those of MPS and EgoAllo.
TIME = "video time"
LOG = "video log"
ASSOCIATIONS = "associations"
MASKS = "masks"
PRIMING = "priming"
SLAM_MAP = "slam map"

_SLAM_ROLES = frozenset({mps.TRAJECTORY, mps.CALIBRATION, mps.SLAM_SUMMARY})
_GAZE_ROLES = frozenset({mps.GAZE, mps.WRISTS, mps.GAZE_SUMMARY, mps.HAND_SUMMARY})


def find_recordings(root: Path | str, options: HdEpicOptions) -> tuple[RecordingFiles, ...]:
    """List the videos of which anything lies on the disk: time file, gaze or SLAM.

    Where the annotations lie there alone, and with ``events_only``, these are all videos that they name.

    Args:
        root: The folder that holds ``HD-EPIC`` and ``hd-epic-annotations``, or one of the two.
        options: What the user chose.

    Raises:
        InputFileError: if there is none, saying what was looked for and what was found.
    """
    root = existing_folder(root, "the folder of HD-EPIC")
    data = root / hd_epic.DATA_FOLDER
    if not data.is_dir():
        data = root
    dataset = f"{SYNTHETIC_PREFIX}hd-epic" if read_synthetic_tree(root) is not None else "hd-epic"
    # Participant's folder of every video, by the video's name.
    videos: dict[str, str] = {}
    folder = data / hd_epic.VIDEOS_FOLDER
    slam_and_gaze = data / hd_epic.MPS_FOLDER
    for suffix in (hd_epic.TIME_SUFFIX, hd_epic.LOG_SUFFIX):
        videos |= {path.name.removesuffix(suffix): path.parent.name for path in folder.glob(f"*/*{suffix}")}
    for pattern in (f"*/{hd_epic.GAZE_FOLDER}/**/mps_*_vrs*", f"*/{hd_epic.OTHER_SLAM_FOLDER}/*"):
        for path in slam_and_gaze.glob(pattern):
            if path.is_dir() or path.suffix == ".zip":
                video = path.name.removesuffix(".zip").removeprefix("mps_").removesuffix("_vrs")
                videos.setdefault(video, path.relative_to(slam_and_gaze).parts[0])
    for path in slam_and_gaze.glob(f"*/{hd_epic.MULTI_SLAM_FOLDER}/{hd_epic.SLAM_MAP_FILE}"):
        for video, number in _mapped(path).items():
            if _archive_or_folder(path.parent, number) is not None:
                videos.setdefault(video, path.relative_to(slam_and_gaze).parts[0])
    expected = f"videos of HD-EPIC: {hd_epic.DATA_FOLDER}/{hd_epic.VIDEOS_FOLDER}/P0X/*{hd_epic.TIME_SUFFIX}"
    expected += f", or {hd_epic.MPS_FOLDER}/P0X/{hd_epic.GAZE_FOLDER}/mps_*_vrs.zip"
    remedy = f"Give the folder that holds {hd_epic.DATA_FOLDER} and {hd_epic.ANNOTATIONS_FOLDER}."
    annotated = _annotation_files(options.annotations, (root, data, data.parent))
    listed = next((file.path for file in annotated if file.role == ASSOCIATIONS), None)
    if listed is not None and (options.events_only or not videos):
        reason = None if options.events_only else _ANNOTATIONS_ALONE
        places = {key: videos.get(key, annotating.participant_of(key)) for key in annotating.annotated_videos(listed)}
        named = ((dataset, video, folder / place, tuple(annotated)) for video, place in places.items())
        return tuple(RecordingFiles(*each, skip_reason=reason) for each in named)
    require(root, (len(videos) > 0, "", expected, names_in(root), remedy))
    recordings = []
    for video, participant in sorted(videos.items()):
        own = folder / participant
        mps_files, skip_reason = _mps_files(slam_and_gaze / participant, video)
        files = [
            *_present(TIME, [own / f"{video}{hd_epic.TIME_SUFFIX}"]),
            *_present(LOG, [own / f"{video}{hd_epic.LOG_SUFFIX}"]),
            *annotated,
            *mps_files,
        ]
        files += find_body(root, video)
        for place in dict.fromkeys((root, data.parent)) if options.poses == "egoallo" else ():
            outputs = find_outputs(place, None, video, options.poses_root, smplh_model=options.smplh_model)
            files += outputs
            if outputs:
                break
        recordings.append(RecordingFiles(dataset, video, own, tuple(files), skip_reason=skip_reason))
    return tuple(recordings)


_ANNOTATIONS_ALONE = (
    "only its annotations are here: `prbench build-dataset hd-epic --events-only` lists its picks and puts"
)


def _mapped(path: Path) -> dict[str, str]:
    """Return videos and numbers of a SLAM map; none where it is missing or damaged, which reading reports."""
    try:
        return annotating.slam_number(path)
    except InputFileError:
        return {}


def _present(role: str, places: Iterable[Path]) -> list[InputFile]:
    """Return the first of several places at which something lies."""
    path = next((place for place in places if is_present(place)), None)
    return [] if path is None else [input_file(role, path)]


def _annotation_files(given: Path | None, places: Iterable[Path]) -> list[InputFile]:
    if given is not None:
        folder = given.expanduser()
    else:
        patterns = (path for place in places for path in sorted(place.glob(f"{hd_epic.ANNOTATIONS_FOLDER}*")))
        # Last the repository itself, which may be all that was downloaded.
        folder = next((path for path in (*patterns, *places) if path.is_dir() and _holds_movements(path)), None)
        if folder is None:
            return []
    movements = (folder / hd_epic.MOVEMENTS_FOLDER, folder)
    priming = [place / name for place in (folder, folder.parent) for name in hd_epic.PRIMING_FOLDERS] + [folder]
    return [
        *_present(ASSOCIATIONS, [place / hd_epic.ASSOCIATIONS_FILE for place in movements]),
        *_present(MASKS, [place / hd_epic.MASKS_FILE for place in movements]),
        *_present(PRIMING, [place / hd_epic.PRIMING_FILE for place in priming]),
    ]


def _holds_movements(folder: Path) -> bool:
    return any(is_present(place / hd_epic.ASSOCIATIONS_FILE) for place in (folder / hd_epic.MOVEMENTS_FOLDER, folder))


def _mps_files(base: Path, video: str) -> tuple[list[InputFile], str | None]:
    """Return the MPS files of a video: gaze and hands of its own archive, the trajectory of the multi-recording SLAM.

    The trajectory of the video's own archive, if there is one, has a world of its own and is not used.

    Returns:
        The files, and why the video must be skipped (None for all that are fine).
    """
    slam_map = base / hd_epic.MULTI_SLAM_FOLDER / hd_epic.SLAM_MAP_FILE
    gaze = _archive_or_folder(base / hd_epic.GAZE_FOLDER, f"mps_{video}_vrs")
    files = [*_listed(gaze, _GAZE_ROLES), *_present(SLAM_MAP, [slam_map])]
    number = _mapped(slam_map).get(video)
    place = None if number is None else _archive_or_folder(slam_map.parent, number)
    other = _archive_or_folder(base / hd_epic.OTHER_SLAM_FOLDER, video)
    if number is None and other is not None:
        if not _listed(other, frozenset({mps.TRAJECTORY})):
            said = f"{hd_epic.OTHER_SLAM_FOLDER}/{other.name} holds no {mps.TRAJECTORY_FILE}: this video was aligned to"
            return files, f"{said} its kitchen by other means than SLAM, in files whose layout is not known"
        place = other
    return [*files, *_listed(place, _SLAM_ROLES)], None


def _listed(place: Path | None, roles: frozenset[str]) -> list[InputFile]:
    if place is None:
        return []
    try:
        return [file for file in find_mps_files(place) if file.role in roles or file.role.startswith(UNREADABLE)]
    except InputFileError:
        return [input_file(f"{UNREADABLE}{place.name}", place)] if place.is_file() else []


def _archive_or_folder(folder: Path, name: str) -> Path | None:
    """Return ``folder/name`` where somebody unpacked it (also one level deeper), else ``folder/name.zip``."""
    for place in (folder / name, *sorted(folder.glob(f"*/{name}"))):
        if place.is_dir():
            return place
    archive = folder / f"{name}.zip"
    return archive if is_present(archive) else None


_MPS = {mps.GAZE: "gaze", mps.WRISTS: "hands"}


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:
    """Return the streams of one video, on the device clock.

    Poses of the glasses lie in archives of hundreds of megabytes: their end is known once the video is read.
    """
    streams = []
    for file in found.files:
        if file.role == TIME:
            streams.append(csv_extent("video frames", file, hd_epic.DEVICE_TIME, 1e-9))
        elif file.role in (*_MPS, mps.TRAJECTORY) and can_be_looked_at(file):
            streams.append(csv_extent(_MPS.get(file.role, "glasses"), file, mps.TIME_COLUMN, 1e-6))
        elif file.role == mps.TRAJECTORY and recording is not None:
            streams.append(Extent("glasses", file.member.rpartition("/")[2], *recording.span))
    return tuple(replace(stream, slack=SEVERAL_SENSORS) for stream in (*streams, *body_extent(found)))


def read_annotations(found: RecordingFiles) -> hd_epic.HdEpicReadings:
    """Read what the annotations say of one video, on a clock that begins with it and never skips an image.

    Raises:
        InputFileError: for a missing or damaged file.
    """
    video = found.recording_id
    associations = found.path(ASSOCIATIONS)
    place = f"{hd_epic.ANNOTATIONS_FOLDER}/{hd_epic.MOVEMENTS_FOLDER}/{hd_epic.ASSOCIATIONS_FILE}"
    require(place, (associations is not None, "", _ANNOTATION, "none", _CLONE))
    assert associations is not None
    movements = annotating.read_tracks(associations, found.path(MASKS), video)
    unreadable = movements.unreadable
    priming = found.path(PRIMING)
    published = None
    if priming is not None:
        published, odd = annotating.read_priming(priming, video)
        unreadable += odd
    last = max((track.end for track in movements.tracks), default=0.0) + _AFTER_LAST
    times = np.rint(np.arange(int(max(last, 1.0) * hd_epic.FPS)) * 1e9 / hd_epic.FPS).astype(np.int64)
    clock = hd_epic.VideoClock(times)
    said = {"messages": movements.remarks, "unreadable": unreadable}
    return hd_epic.HdEpicReadings(video, found.folder.name, clock, movements.tracks, published, None, None, **said)


_AFTER_LAST = 2.0  # s; masks of the last movement's end may lie behind it
_ANNOTATION = "this file of the annotation repository"
_CLONE = f"Clone the repository beside {hd_epic.DATA_FOLDER}, or name it: --option annotations=DIR."


def read_readings(found: RecordingFiles) -> hd_epic.HdEpicReadings:
    """Read all that curation needs of one video.

    Raises:
        InputFileError: for a missing or damaged file; of SLAM it says which archive is missing.
    """
    video = found.recording_id
    annotations = read_annotations(found)
    place = f"{hd_epic.ANNOTATIONS_FOLDER}/{hd_epic.MOVEMENTS_FOLDER}/{hd_epic.MASKS_FILE}"
    require(place, (found.path(MASKS) is not None, "", _ANNOTATION, "none", _CLONE))
    times = found.require(TIME, f"{video}{hd_epic.TIME_SUFFIX}")
    clock, clock_remarks = annotating.read_video_clock(times, found.path(LOG))
    glasses = _read_mps(found)
    body = read_bodies(found, cpf=mps_streams(replace(glasses, wrists=None), world_from_source=np.eye(4)).head)
    messages = (*annotations.messages, *clock_remarks, *((NO_OUTPUTS,) if body is None else ()))
    return replace(annotations, clock=clock, glasses=glasses, body=body, messages=messages)


def _read_mps(found: RecordingFiles) -> mps.MpsReadings:
    """Read trajectory, gaze and hands; a missing file is named by the archive that a download by video leaves out."""
    for file in found.files:
        if file.role.startswith(UNREADABLE):
            find_mps_files(file.path)
    video = found.recording_id
    participant = found.folder.name
    folder = f"{hd_epic.MPS_FOLDER}/{participant}"
    if found.path(mps.TRAJECTORY) is None:
        slam_map = found.path(SLAM_MAP)
        place = f"{folder}/{hd_epic.MULTI_SLAM_FOLDER}"
        expected = f"this file, which tells the SLAM zip of {video}"
        remedy = f"Download SLAM/multi of {participant}: a download by video fetches gaze only."
        require(f"{place}/{hd_epic.SLAM_MAP_FILE}", (slam_map is not None, "", expected, "none", remedy))
        assert slam_map is not None
        number = annotating.slam_number(slam_map).get(video)
        key = f"{participant}/{video}.vrs"
        remedy = f"It has no multi-recording SLAM; three videos have {hd_epic.OTHER_SLAM_FOLDER}/*.zip instead."
        require(slam_map, (number is not None, key, "the number of a SLAM zip", "no such key", remedy))
        expected = f"the trajectory of {video}"
        lacking = f"SLAM zip {number} of {participant} missing"
        remedy = "Download it: a download by video fetches gaze only, not SLAM."
        raise InputFileError(f"{place}/{number}.zip", "", expected=expected, found=lacking, remedy=remedy)
    has_gaze = found.path(mps.GAZE) is not None
    archive = f"{folder}/{hd_epic.GAZE_FOLDER}/mps_{video}_vrs.zip"
    require(archive, (has_gaze, "", "eye gaze of this video", "none", "Download GAZE_HAND of this video."))
    readings = read_mps(found)
    place = f"{folder}: {mps.TRAJECTORY_FILE} of {video}"
    remedy = "Masks and bodies stand in the world of the original file; use that one."
    require_up(place, readings.trajectory, (0.0, 0.0, 1.0), within=1e-2, remedy=remedy)
    return readings
