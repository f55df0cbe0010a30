"""The files of one recording → :class:`prbench.readers.aria_mps.format.MpsReadings`."""

from __future__ import annotations

from prbench.errors import InputFileError
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.calibration import OnlineCalibration, read_first_calibration
from prbench.readers.aria_mps.find import UNREADABLE, is_personalized
from prbench.readers.aria_mps.gaze import read_gaze_angles
from prbench.readers.aria_mps.hands import read_hand_tracking, read_wrists
from prbench.readers.aria_mps.trajectory import read_near, read_trajectory
from prbench.readers.aria_mps.wanted import NearGaze
from prbench.readers.aria_status import read_warnings
from prbench.readers.found import InputFile, RecordingFiles
from prbench.readers.zipped import archive_members, source_of

_REQUIRED = {
    mps.TRAJECTORY: f"{mps.SLAM_FOLDER}/{mps.TRAJECTORY_FILE}",
    mps.GAZE: f"{mps.GAZE_FOLDER}/{mps.GAZE_FILES[2]}",
}


def read_mps(found: RecordingFiles, *, thin: bool = True) -> mps.MpsReadings:
    """Read trajectory, gaze, hands and calibration of one recording, from files of this format's roles.

    A stream whose own summary reports an ERROR is refused: hands and calibration are then left out with a message,
    without trajectory or gaze there is no recording.

    Args:
        found: The recording's files; those of other roles are not looked at.
        thin: Read only the poses around the gaze times and a grid of 30 Hz; else all of them, which needs more time
            and memory and notices damage in every row.

    Raises:
        InputFileError: if trajectory or gaze is missing, damaged, or reported as an ERROR.
    """
    trajectory_file, gaze_file = (_require(found, role) for role in (mps.TRAJECTORY, mps.GAZE))
    remarks = [*_warnings(found, mps.SLAM_SUMMARY), *_warnings(found, mps.GAZE_SUMMARY)]
    gaze = read_gaze_angles(source_of(gaze_file))
    poses = source_of(trajectory_file)
    trajectory = read_near(poses, NearGaze(gaze.time_us)) if thin else read_trajectory(poses)
    calibration = _read_calibration(found)
    wrists, hand_remarks = _read_wrists(found)
    return mps.MpsReadings(
        trajectory=trajectory,
        gaze=gaze,
        gaze_kind="personalized" if is_personalized(gaze_file) else "general",
        wrists=wrists,
        glasses_size=None if calibration is None else calibration.size,
        device_from_rgb=None if calibration is None else calibration.device_from_camera["camera-rgb"],
        messages=(*remarks, *trajectory.remarks, *hand_remarks),
    )


def _file(found: RecordingFiles, role: str) -> InputFile | None:
    return next((file for file in found.files if file.role == role), None)


def _require(found: RecordingFiles, role: str) -> InputFile:
    file = _file(found, role)
    if file is None:
        for archive in (other for other in found.files if other.role.startswith(UNREADABLE)):
            archive_members(archive.path)  # says what is wrong with it
        found.require(role, _REQUIRED[role])  # says what was looked for
        raise AssertionError("a missing role was found")
    return file


def _warnings(found: RecordingFiles, role: str) -> tuple[str, ...]:
    file = _file(found, role)
    return () if file is None else read_warnings(source_of(file))


def _read_calibration(found: RecordingFiles) -> OnlineCalibration | None:
    file = _file(found, mps.CALIBRATION)
    return None if file is None else read_first_calibration(source_of(file))


def _read_wrists(found: RecordingFiles) -> tuple[mps.WristPositions | None, tuple[str, ...]]:
    """Wrists and palms: of the file made for them (10 Hz), else of the landmarks; None where neither is usable."""
    wrists, landmarks = _file(found, mps.WRISTS), _file(found, mps.HAND_TRACKING)
    if wrists is None and landmarks is None:
        return None, ()
    try:
        remarks = _warnings(found, mps.HAND_SUMMARY)
    except InputFileError as error:
        return None, (f"the hands are not used: {error}",)
    if wrists is not None:
        return read_wrists(source_of(wrists)), remarks
    assert landmarks is not None
    return read_hand_tracking(source_of(landmarks)), remarks
