"""Find and read the files of HD-EPIC videos, zipped or not (docs/specification/hd-epic.md#folder-tree)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.readers import ReaderOptions, read_synthetic_tree
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import UNREADABLE, find_mps_files, read_mps
from prbench.readers.aria_mps.format import MpsReadings
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.egoallo.files import body_extent, find_outputs
from prbench.readers.egoallo.to_recording import NO_OUTPUTS
from prbench.readers.extents import SEVERAL_SENSORS, Extent, can_be_looked_at, csv_extent, json_extent
from prbench.readers.found import InputFile, RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.annotations import read_frames, read_priming, read_tracks, read_video_clock, slam_number
from prbench.readers.hd_epic.to_recording import source_head
from prbench.recording import Recording

_BoxChoice = Literal["point", "cube"]


class HdEpicOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the reader; see the fields."""

    source: Literal["mps", "intermediate"] = "mps"
    """Source of camera and gaze: the MPS files of SLAM-and-Gaze, or the newer per-frame intermediate data."""
    boxes: _BoxChoice = "point"
    """``point``: zero-size boxes at the annotated points; ``cube``: cubes as large as the 2D boxes say."""
    annotations: Path | None = None
    """The annotation repository, where it does not lie beside the data."""
    poses: Literal["egoallo"] = "egoallo"
    """Source of bodies."""
    smplh_model: Path | None = None
    """The licensed SMPL-H ``model.npz`` that turns EgoAllo's outputs into joints."""
    poses_root: Path | None = None
    """Folder of EgoAllo's outputs by video, where it is not ``egoallo`` below the root."""


TIME = "video time"
LOG = "video log"
ASSOCIATIONS = "associations"
MASKS = "masks"
PRIMING = "priming"
SLAM_MAP = "slam map"
FRAMES = "frames"
DEVICE_CALIBRATION = "device calibration"
"""Roles of the files of a video, beside those of MPS and EgoAllo."""

_SLAM_ROLES = frozenset({mps.TRAJECTORY, mps.CALIBRATION, mps.SLAM_SUMMARY})
_GAZE_ROLES = frozenset({mps.GAZE, mps.WRISTS, mps.HAND_TRACKING, mps.GAZE_SUMMARY, mps.HAND_SUMMARY})


@dataclass(frozen=True)
class Copy:
    """A user's copy of the dataset."""

    root: Path
    """As given."""
    data: Path
    """The folder ``HD-EPIC``: the root itself, or inside it."""
    annotations: Path | None
    intermediate: Path | None


def find_recordings(root: Path | str, options: HdEpicOptions) -> tuple[RecordingFiles, ...]:
    """List the videos of which anything lies on the disk: time file, gaze, SLAM or intermediate data.

    Args:
        root: The folder that holds ``HD-EPIC`` and ``hd-epic-annotations``, or ``HD-EPIC`` itself.
        options: What the user chose.

    Raises:
        InputFileError: if there is none, saying what was looked for and what was found.
    """
    root = existing_folder(root, "the folder of HD-EPIC")
    data = root / hd_epic.DATA_FOLDER
    if not data.is_dir() and root.name != hd_epic.INTERMEDIATE_FOLDER:
        data = root
    around = dict.fromkeys((root, data, data.parent))
    given = options.annotations
    copy = Copy(
        root,
        data,
        given.expanduser() if given is not None else _first_folder(around, f"{hd_epic.ANNOTATIONS_FOLDER}*"),
        root if root.name == hd_epic.INTERMEDIATE_FOLDER else _first_folder(around, hd_epic.INTERMEDIATE_FOLDER),
    )
    dataset = f"{SYNTHETIC_PREFIX}hd-epic" if read_synthetic_tree(root) is not None else "hd-epic"
    # Participant's folder of every video, by the video's name.
    videos: dict[str, str] = {}
    folder = copy.data / hd_epic.VIDEOS_FOLDER
    slam_and_gaze = copy.data / hd_epic.MPS_FOLDER
    for suffix in (hd_epic.TIME_SUFFIX, hd_epic.LOG_SUFFIX):
        videos |= {path.name.removesuffix(suffix): path.parent.name for path in folder.glob(f"*/*{suffix}")}
    for path in slam_and_gaze.glob(f"*/{hd_epic.GAZE_FOLDER}/**/mps_*_vrs*"):
        if path.is_dir() or path.suffix == ".zip":
            video = path.name.removesuffix(".zip").removeprefix("mps_").removesuffix("_vrs")
            videos.setdefault(video, path.relative_to(slam_and_gaze).parts[0])
    for path in slam_and_gaze.glob(f"*/{hd_epic.OTHER_SLAM_FOLDER}/*"):
        if path.is_dir() or path.suffix == ".zip":
            videos.setdefault(path.name.removesuffix(".zip"), path.relative_to(slam_and_gaze).parts[0])
    for path in slam_and_gaze.glob(f"*/{hd_epic.MULTI_SLAM_FOLDER}/{hd_epic.SLAM_MAP_FILE}"):
        participant = path.relative_to(slam_and_gaze).parts[0]
        for video, number in _mapped(path):
            if _slam_place(copy, participant, number) is not None:
                videos.setdefault(video, participant)
    if copy.intermediate is not None:
        found = copy.intermediate.glob(f"*/*/{hd_epic.FRAMES_FILE}")
        videos |= {path.parent.name: path.parent.parent.name for path in found if path.parent.name not in videos}
    if not videos:
        raise InputFileError(
            root,
            "",
            expected=f"videos of HD-EPIC: {hd_epic.DATA_FOLDER}/{hd_epic.VIDEOS_FOLDER}/P0X/*{hd_epic.TIME_SUFFIX},"
            f" {hd_epic.MPS_FOLDER}/P0X/{hd_epic.GAZE_FOLDER}/mps_*_vrs.zip, or the intermediate data",
            found=names_in(root),
            remedy=f"Give the folder that holds {hd_epic.DATA_FOLDER} and {hd_epic.ANNOTATIONS_FOLDER}.",
        )
    return tuple(_recording(copy, dataset, videos[name], name, options) for name in sorted(videos))


def _first_folder(places: Iterable[Path], pattern: str) -> Path | None:
    found = (path for place in places if place.is_dir() for path in sorted(place.glob(pattern)) if path.is_dir())
    return next(found, None)


def _mapped(path: Path) -> list[tuple[str, str]]:
    """Videos and numbers of a SLAM map; none where it is damaged, which reading reports."""
    try:
        numbers = slam_number(path)
    except InputFileError:
        return []
    return list(numbers.items())


def _recording(copy: Copy, dataset: str, participant: str, video: str, options: HdEpicOptions) -> RecordingFiles:
    own = copy.data / hd_epic.VIDEOS_FOLDER / participant
    files = [
        *_present(TIME, [own / f"{video}{hd_epic.TIME_SUFFIX}"]),
        *_present(LOG, [own / f"{video}{hd_epic.LOG_SUFFIX}"]),
        *_annotation_files(copy.annotations),
    ]
    skip_reason = None
    if options.source == "mps":
        mps_files, skip_reason = _mps_files(copy, participant, video)
        files += mps_files
    elif copy.intermediate is not None:
        folder = copy.intermediate / participant / video
        files += _present(FRAMES, [folder / hd_epic.FRAMES_FILE])
        files += _present(DEVICE_CALIBRATION, [folder / hd_epic.DEVICE_CALIBRATION_FILE])
    files += _body_files(copy, video, options)
    return RecordingFiles(dataset, video, own, tuple(files), skip_reason=skip_reason)


def _present(role: str, places: Iterable[Path]) -> list[InputFile]:
    """The first of several places at which something lies."""
    path = next((place for place in places if is_present(place)), None)
    return [] if path is None else [input_file(role, path)]


def _annotation_files(folder: Path | None) -> list[InputFile]:
    if folder is None:
        return []
    movements = (folder / hd_epic.MOVEMENTS_FOLDER, folder)
    around = (folder, folder.parent)
    priming = [place / name for place in around for name in hd_epic.PRIMING_FOLDERS] + [folder]
    return [
        *_present(ASSOCIATIONS, [place / hd_epic.ASSOCIATIONS_FILE for place in movements]),
        *_present(MASKS, [place / hd_epic.MASKS_FILE for place in movements]),
        *_present(PRIMING, [place / hd_epic.PRIMING_FILE for place in priming]),
    ]


def _mps_files(copy: Copy, participant: str, video: str) -> tuple[list[InputFile], str | None]:
    """MPS files of a video: gaze and hands from its own archive, the trajectory from the multi-recording SLAM.

    The trajectory of the video's own archive, if there is one, has a world of its own and is not used.

    Returns:
        The files, and why the video must be skipped (None for all that are fine).
    """
    base = copy.data / hd_epic.MPS_FOLDER / participant
    files = []
    gaze = _archive_or_folder(base / hd_epic.GAZE_FOLDER, f"mps_{video}_vrs")
    if gaze is not None:
        files += _listed(gaze, _GAZE_ROLES)
    slam_map = base / hd_epic.MULTI_SLAM_FOLDER / hd_epic.SLAM_MAP_FILE
    files += _present(SLAM_MAP, [slam_map])
    number = dict(_mapped(slam_map)).get(video) if slam_map.is_file() else None
    place = None if number is None else _slam_place(copy, participant, number)
    other = _archive_or_folder(base / hd_epic.OTHER_SLAM_FOLDER, video)
    if place is None and number is None and other is not None:
        if not _listed(other, frozenset({mps.TRAJECTORY})):
            return files, (
                f"{hd_epic.OTHER_SLAM_FOLDER}/{other.name} holds no {mps.TRAJECTORY_FILE}: this video was aligned to"
                " its kitchen by other means than SLAM, in files whose layout is not known"
            )
        place = other
    if place is not None:
        files += _listed(place, _SLAM_ROLES)
    return files, None


def _listed(place: Path, roles: frozenset[str]) -> list[InputFile]:
    try:
        return [file for file in find_mps_files(place) if file.role in roles or file.role.startswith(UNREADABLE)]
    except InputFileError:
        return [input_file(f"{UNREADABLE}{place.name}", place)] if place.is_file() else []


def _slam_place(copy: Copy, participant: str, number: str) -> Path | None:
    return _archive_or_folder(copy.data / hd_epic.MPS_FOLDER / participant / hd_epic.MULTI_SLAM_FOLDER, number)


def _archive_or_folder(folder: Path, name: str) -> Path | None:
    """``folder/name`` where somebody unpacked it (also one level deeper), else ``folder/name.zip``."""
    for place in (folder / name, *sorted(folder.glob(f"*/{name}"))):
        if place.is_dir():
            return place
    archive = folder / f"{name}.zip"
    return archive if is_present(archive) else None


def _body_files(copy: Copy, video: str, options: HdEpicOptions) -> tuple[InputFile, ...]:
    for root in dict.fromkeys((copy.root, copy.data.parent)):
        outputs = find_outputs(root, None, video, options.poses_root, smplh_model=options.smplh_model)
        if outputs:
            return outputs
    return ()


_MPS = {mps.TRAJECTORY: "glasses", mps.GAZE: "gaze", mps.WRISTS: "hands", mps.HAND_TRACKING: "hands"}


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:
    """The streams of one video, on the device clock.

    Poses of the glasses lie in archives of hundreds of megabytes: their end is known once the video is read.
    """
    streams = []
    for file in found.files:
        if file.role == TIME:
            streams.append(csv_extent("video frames", file, hd_epic.DEVICE_TIME, 1e-9))
        elif file.role == FRAMES:
            streams.append(json_extent("frames of the intermediate data", file))
        elif file.role in _MPS and can_be_looked_at(file):
            streams.append(csv_extent(_MPS[file.role], file, mps.TIME_COLUMN, 1e-6))
        elif file.role == mps.TRAJECTORY and recording is not None:
            streams.append(Extent("glasses", file.member.rpartition("/")[2], *recording.span))
    return tuple(replace(stream, slack=SEVERAL_SENSORS) for stream in (*streams, *body_extent(found)))


_UP = (0.0, 0.0, 1.0)


def read_readings(found: RecordingFiles, options: HdEpicOptions) -> hd_epic.HdEpicReadings:
    """Read all that curation needs of one video.

    Raises:
        InputFileError: for a missing or damaged file; of SLAM it says which archive is missing.
    """
    video = found.recording_id
    participant = found.folder.name
    associations = _annotation(found, ASSOCIATIONS)
    masks = _annotation(found, MASKS)
    tracks, track_remarks = read_tracks(associations, masks, video)
    priming = found.path(PRIMING)
    frames = _read_frames(found) if options.source == "intermediate" else None
    clock, clock_remarks = _read_clock(found, frames)
    glasses = _read_mps(found) if frames is None else frames
    body = read_bodies(found, cpf=source_head(glasses))
    return hd_epic.HdEpicReadings(
        video=video,
        participant_id=participant,
        clock=clock,
        tracks=tracks,
        priming=None if priming is None else read_priming(priming, video),
        glasses=glasses,
        body=body,
        messages=(*track_remarks, *clock_remarks, *((NO_OUTPUTS,) if body is None else ())),
    )


def _annotation(found: RecordingFiles, role: str) -> Path:
    path = found.path(role)
    if path is not None:
        return path
    name = hd_epic.ASSOCIATIONS_FILE if role == ASSOCIATIONS else hd_epic.MASKS_FILE
    raise InputFileError(
        f"{hd_epic.ANNOTATIONS_FOLDER}/{hd_epic.MOVEMENTS_FOLDER}/{name}",
        "",
        expected="this file of the annotation repository",
        found="none",
        remedy=f"Clone the repository beside {hd_epic.DATA_FOLDER}, or name it: --option annotations=DIR.",
    )


def _read_clock(
    found: RecordingFiles, frames: hd_epic.FrameReadings | None
) -> tuple[hd_epic.VideoClock, tuple[str, ...]]:
    """Read the time file; the intermediate data hold the same time of every frame."""
    path = found.path(TIME)
    if path is None and frames is not None:
        return hd_epic.VideoClock(frames.tracking_ns), ("frame times are those of the intermediate data",)
    name = f"{found.recording_id}{hd_epic.TIME_SUFFIX}"
    return read_video_clock(found.require(TIME, name), found.path(LOG))


def _read_frames(found: RecordingFiles) -> hd_epic.FrameReadings:
    path = found.path(FRAMES)
    if path is not None:
        return read_frames(path, found.path(DEVICE_CALIBRATION))
    raise InputFileError(
        f"{hd_epic.INTERMEDIATE_FOLDER}/{found.folder.name}/{found.recording_id}/{hd_epic.FRAMES_FILE}",
        "",
        expected="this file, since source=intermediate was chosen",
        found="none",
        remedy="Download the intermediate data, or leave the option out to use SLAM-and-Gaze.",
    )


def _read_mps(found: RecordingFiles) -> MpsReadings:
    """Trajectory, gaze and hands; what is missing is named by the archive that a download by video leaves out."""
    for file in found.files:
        if file.role.startswith(UNREADABLE):
            find_mps_files(file.path)
    participant = found.folder.name
    folder = f"{hd_epic.MPS_FOLDER}/{participant}"
    if found.path(mps.TRAJECTORY) is None:
        raise _missing_slam(found, participant, folder)
    if found.path(mps.GAZE) is None:
        raise InputFileError(
            f"{folder}/{hd_epic.GAZE_FOLDER}/mps_{found.recording_id}_vrs.zip",
            "",
            expected="eye gaze of this video",
            found="none",
            remedy="Download GAZE_HAND of this video.",
        )
    readings = read_mps(found)
    if np.linalg.norm(readings.trajectory.up - np.array(_UP)) > 1e-2:
        raise InputFileError(
            f"{folder}: {mps.TRAJECTORY_FILE} of {found.recording_id}",
            "gravity columns",
            expected="gravity along -Z (the kitchens are Z up)",
            found=f"up = {(np.round(readings.trajectory.up, 3) + 0.0).tolist()}",
            remedy="Masks and bodies stand in the world of the original file; use that one.",
        )
    return readings


def _missing_slam(found: RecordingFiles, participant: str, folder: str) -> InputFileError:
    slam_map = found.path(SLAM_MAP)
    if slam_map is None:
        return InputFileError(
            f"{folder}/{hd_epic.MULTI_SLAM_FOLDER}/{hd_epic.SLAM_MAP_FILE}",
            "",
            expected=f"this file, which tells the SLAM zip of {found.recording_id}",
            found="none",
            remedy=f"Download SLAM/multi of {participant}: a download by video fetches gaze only.",
        )
    number = slam_number(slam_map).get(found.recording_id)
    if number is None:
        return InputFileError(
            slam_map,
            f"{participant}/{found.recording_id}.vrs",
            expected="the number of a SLAM zip",
            found="no such key",
            remedy=f"It has no multi-recording SLAM; three videos have {hd_epic.OTHER_SLAM_FOLDER}/*.zip instead.",
        )
    archive = f"{folder}/{hd_epic.MULTI_SLAM_FOLDER}/{number}.zip"
    return InputFileError(
        archive,
        "",
        expected=f"the trajectory of {found.recording_id}",
        found=f"SLAM zip {number} of {participant} missing",
        remedy="Download it: a download by video fetches gaze only, not SLAM."
        " Or use the intermediate data: --option source=intermediate.",
    )
