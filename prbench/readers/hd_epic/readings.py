"""The files of one video → :class:`prbench.readers.hd_epic.format.HdEpicReadings`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.find import UNREADABLE, find_mps_files
from prbench.readers.aria_mps.format import MpsReadings
from prbench.readers.aria_mps.readings import read_mps
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.egoallo.to_recording import NO_OUTPUTS
from prbench.readers.found import RecordingFiles
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic import places
from prbench.readers.hd_epic.annotations import read_priming, read_tracks
from prbench.readers.hd_epic.intermediate import read_frames
from prbench.readers.hd_epic.places import HdEpicOptions
from prbench.readers.hd_epic.to_recording import source_head
from prbench.readers.hd_epic.video_clock import read_video_clock, slam_number

_UP = (0.0, 0.0, 1.0)


def read_readings(found: RecordingFiles, options: HdEpicOptions) -> hd_epic.HdEpicReadings:
    """Read all that curation needs of one video.

    Raises:
        InputFileError: for a missing or damaged file; of SLAM it says which archive is missing.
    """
    video = found.recording_id
    participant = found.folder.name
    associations = _annotation(found, places.ASSOCIATIONS)
    masks = _annotation(found, places.MASKS)
    tracks, track_remarks = read_tracks(associations, masks, video)
    priming = found.path(places.PRIMING)
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
    name = hd_epic.ASSOCIATIONS_FILE if role == places.ASSOCIATIONS else hd_epic.MASKS_FILE
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
    path = found.path(places.TIME)
    if path is None and frames is not None:
        return hd_epic.VideoClock(frames.tracking_ns), ("frame times are those of the intermediate data",)
    name = f"{found.recording_id}{hd_epic.TIME_SUFFIX}"
    return read_video_clock(found.require(places.TIME, name), found.path(places.LOG))


def _read_frames(found: RecordingFiles) -> hd_epic.FrameReadings:
    path = found.path(places.FRAMES)
    if path is not None:
        return read_frames(path, found.path(places.DEVICE_CALIBRATION))
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
    slam_map = found.path(places.SLAM_MAP)
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
