"""Find and read the files of the Machine Perception Services: by name, below a folder or in archives.

Source: docs/specification/aria-mps.md#folder-tree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import msgspec
import numpy as np
import pyarrow as pa
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.arrays import require_column
from prbench.limits import FARTHEST_POSITION, LARGEST_ANGLE, LONGEST_LINE
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.trajectory import read_near, read_trajectory
from prbench.readers.files import (
    Source,
    archive_members,
    column_vectors,
    decode_json,
    opened,
    read_columns,
    read_header,
    require_increasing,
    require_poses,
    shown,
    source_of,
)
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present

_ROLES: dict[str, tuple[str, ...]] = {
    mps.TRAJECTORY: (mps.TRAJECTORY_FILE,),
    mps.GAZE: mps.GAZE_FILES,
    mps.CALIBRATION: (mps.CALIBRATION_FILE,),
    mps.WRISTS: (mps.WRISTS_FILE,),
    mps.HAND_TRACKING: (mps.HAND_TRACKING_FILE,),
}
_SUMMARIES = {
    mps.SLAM_SUMMARY: (mps.TRAJECTORY, mps.CALIBRATION),
    mps.GAZE_SUMMARY: (mps.GAZE,),
    mps.HAND_SUMMARY: (mps.WRISTS, mps.HAND_TRACKING),
}
"""A summary lies beside one of the files that it speaks of."""
UNREADABLE = "unreadable archive: "
"""Role of an archive that cannot be opened: this and its name."""
_USUAL_FOLDERS = ("slam", "trajectory", "eye_gaze", "hand_tracking")


def find_mps_files(root: Path) -> tuple[InputFile, ...]:
    """The files of one recording, under their present or old names.

    Args:
        root: The folder of one recording's outputs, or a zip archive of it; in a folder, archives are looked into too.

    Returns:
        At most one file a role: of several with the best name that in one of the usual folders, then the one that lies
        highest, plain before archived. Nothing is required here.

    Raises:
        InputFileError: if ``root`` is an archive and damaged.
    """
    present = _files_of_archive(root) if root.is_file() else _files_below(root)
    found = {role: file for role, names in _ROLES.items() if (file := _best(present, names, role))}
    for role, companions in _SUMMARIES.items():
        beside = [_folder(found[companion]) for companion in companions if companion in found]
        summaries = [file for file in present if _name(file) == mps.SUMMARY_FILE and _folder(file) in beside]
        if summaries:
            found[role] = InputFile(role, summaries[0].path, summaries[0].size, summaries[0].member)
    unreadable = (file.path for file in present if file.role == UNREADABLE)
    return (*found.values(), *(input_file(f"{UNREADABLE}{path.name}", path) for path in unreadable))


def find_gaze_file(folder: Path) -> Path | None:
    """The preferred gaze file of a folder, under its new or an old name; None if there is none."""
    return next((folder / name for name in mps.GAZE_FILES if is_present(folder / name)), None)


def is_personalized(file: InputFile) -> bool:
    """Return True where a gaze file was made with the wearer's own calibration."""
    return _name(file) in mps.PERSONALIZED_GAZE_FILES


def _files_below(root: Path) -> list[InputFile]:
    wanted = {name for names in _ROLES.values() for name in names} | {mps.SUMMARY_FILE}
    files = []
    for path in sorted(root.rglob("*")):
        if path.name in wanted:
            files.append(input_file("", path))
        elif path.suffix == ".zip" and path.is_file():
            files += _files_of_archive_if_whole(path)
    return files


def _files_of_archive_if_whole(archive: Path) -> list[InputFile]:
    """One damaged archive does not hide the files beside it; reading names it where something is missing."""
    try:
        return _files_of_archive(archive)
    except InputFileError:
        return [input_file(UNREADABLE, archive)]


def _files_of_archive(archive: Path) -> list[InputFile]:
    return [InputFile("", archive, size, member) for member, size in sorted(archive_members(archive).items())]


def _best(present: Sequence[InputFile], names: Sequence[str], role: str) -> InputFile | None:
    candidates = [file for file in present if _name(file) in names]
    if not candidates:
        return None
    best = min(candidates, key=lambda file: _rank(file, names))
    return InputFile(role, best.path, best.size, best.member)


def _rank(file: InputFile, names: Sequence[str]) -> tuple[int, bool, int, bool, str]:
    folder = _folder(file)
    unusual = folder.name not in _USUAL_FOLDERS
    return names.index(_name(file)), unusual, len(folder.parts), bool(file.member), str(folder)


def _name(file: InputFile) -> str:
    return PurePosixPath(file.member).name if file.member else file.path.name


def _folder(file: InputFile) -> PurePosixPath:
    """The folder of a file; an archive counts as one."""
    path = file.path / file.member if file.member else file.path
    return PurePosixPath(path.as_posix()).parent


_ANYTHING = msgspec.json.Decoder()


def read_warnings(path: Source) -> tuple[str, ...]:
    """Read what the operators of a stream warn of; their names vary between versions, and none is required.

    Returns:
        One remark for each operator with the status WARNING.

    Raises:
        InputFileError: if the file is damaged, or an operator reports an ERROR: the stream is then not to be used.
    """
    warnings = []
    for operator, report in _reports(decode_json(path, _ANYTHING)):
        if report["status"] == "ERROR":
            raise InputFileError(
                shown(path),
                operator,
                expected="no operator with the status ERROR",
                found=f"ERROR{_reason(report)}",
                remedy="The services could not compute this stream; leave the recording out, or request it again.",
            )
        if report["status"] == "WARNING":
            warnings.append(f"{shown(path).parent.name}: {operator} warns{_reason(report)}")
    return tuple(warnings)


def _reports(summary: object) -> Iterator[tuple[str, dict]]:
    """Every entry that has a status, with the name of its operator; some operators hold a list of them."""
    if not isinstance(summary, dict):
        return
    for operator, value in summary.items():
        for report in value if isinstance(value, list) else [value]:
            if isinstance(report, dict) and "status" in report:
                yield str(operator), report


def _reason(report: dict) -> str:
    details = [report.get("message"), *report.get("errors", []), *report.get("warnings", [])]
    said = "; ".join(str(detail) for detail in details if detail)
    return f" ({said[:160]})" if said else ""


_LIKE_DEGREES = "Such angles look like degrees, or are damaged; use the file as it was released."
_Columns = Callable[[str], tuple[str, ...]]


class _Translation(msgspec.Struct):
    translation: tuple[float, float, float] = msgspec.field(name="Translation")
    quaternion: tuple[float, tuple[float, float, float]] = msgspec.field(name="UnitQuaternion")


class _Camera(msgspec.Struct):
    label: str = msgspec.field(name="Label")
    pose: _Translation = msgspec.field(name="T_Device_Camera")


class _CalibrationRow(msgspec.Struct):
    tracking_timestamp_us: int
    cameras: tuple[_Camera, ...] = msgspec.field(name="CameraCalibrations")


@dataclass(frozen=True)
class OnlineCalibration:
    """Places of the cameras on the glasses, at one instant."""

    time_us: int
    device_from_camera: dict[str, Float[np.ndarray, "4 4"]]
    """Maps a camera's label (``camera-slam-left``, ``camera-slam-right``, ``camera-rgb``) to its pose."""

    @property
    def slam_baseline(self) -> float:
        """Distance between the two SLAM cameras, metres; it tells the size of the glasses."""
        left, right = (self.device_from_camera[f"camera-slam-{side}"] for side in ("left", "right"))
        return float(np.linalg.norm(left[:3, 3] - right[:3, 3]))

    @property
    def size(self) -> mps.GlassesSize:
        """Size of the glasses."""
        return mps.glasses_size(self.slam_baseline)


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
        thin: Keep only the poses around the gaze times and a grid of 30 Hz; else all of them, which needs more memory.

    Raises:
        InputFileError: if trajectory or gaze is missing, damaged, or reported as an ERROR.
    """
    trajectory_file, gaze_file = (_require(found, role) for role in (mps.TRAJECTORY, mps.GAZE))
    remarks = [*_warnings(found, mps.SLAM_SUMMARY), *_warnings(found, mps.GAZE_SUMMARY)]
    gaze = read_gaze_angles(source_of(gaze_file))
    poses = source_of(trajectory_file)
    trajectory = read_near(poses, gaze.time_us) if thin else read_trajectory(poses)
    file = _file(found, mps.CALIBRATION)
    calibration = None if file is None else read_first_calibration(source_of(file))
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


def _require(found: RecordingFiles, role: str) -> InputFile:
    file = _file(found, role)
    if file is None:
        for archive in (other for other in found.files if other.role.startswith(UNREADABLE)):
            archive_members(archive.path)  # says what is wrong with it
        found.require(role, _REQUIRED[role])  # says what was looked for
        raise AssertionError("a missing role was found")
    return file


def _file(found: RecordingFiles, role: str) -> InputFile | None:
    return next((file for file in found.files if file.role == role), None)


def _warnings(found: RecordingFiles, role: str) -> tuple[str, ...]:
    file = _file(found, role)
    return () if file is None else read_warnings(source_of(file))


def read_gaze_angles(path: Source) -> mps.GazeAngles:
    """Read one gaze file of any of the three schemas, told apart by columns (docs/specification/aria-mps.md#eye-gaze).

    Two yaws (schema B) become one; bounds that a schema lacks are NaN, and so is a missing depth.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, or time runs backwards.
    """
    names = read_header(path)
    # Schema B has a yaw for each eye, the other two schemas have one for both.
    two_eyes = mps.YAW not in names and mps.LEFT_YAW in names
    yaws = (mps.LEFT_YAW, mps.RIGHT_YAW) if two_eyes else (mps.YAW,)
    optional = (
        *mps.YAW_RANGE,
        *mps.LEFT_YAW_RANGE,
        *mps.RIGHT_YAW_RANGE,
        *mps.PITCH_RANGE,
        mps.DEPTH,
    )
    wanted = (*yaws, mps.PITCH, *(name for name in optional if name in names))
    table = read_columns(path, {mps.TIME_COLUMN: int, **dict.fromkeys(wanted, float)})
    if len(table) == 0:
        raise InputFileError(
            shown(path),
            "",
            expected="gaze rows",
            found="none",
            remedy="Without gaze nothing is primed; download it again.",
        )
    require_increasing(path, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    for name in (*yaws, mps.PITCH):  # their bounds steer no ray
        require_column(shown(path), name, columns[name], largest=LARGEST_ANGLE, unit="rad", remedy=_LIKE_DEGREES)
    if mps.DEPTH in columns:
        require_column(shown(path), mps.DEPTH, columns[mps.DEPTH], largest=FARTHEST_POSITION, unit="m")
    unknown = np.full(len(table), np.nan)

    def pair(names: tuple[str, str]) -> np.ndarray:
        return np.column_stack([columns.get(name, unknown) for name in names])

    yaw = mps.combined_yaw(columns[mps.LEFT_YAW], columns[mps.RIGHT_YAW]) if two_eyes else columns[mps.YAW]
    yaw_range = (
        mps.combined_yaw(pair(mps.LEFT_YAW_RANGE), pair(mps.RIGHT_YAW_RANGE)) if two_eyes else pair(mps.YAW_RANGE)
    )
    return mps.GazeAngles(
        columns[mps.TIME_COLUMN],
        yaw,
        columns[mps.PITCH],
        columns.get(mps.DEPTH, unknown),
        yaw_range,
        pair(mps.PITCH_RANGE),
    )


def read_first_calibration(path: Source) -> OnlineCalibration:
    """Read the first record of ``online_calibration.jsonl``; later ones differ by fractions of a millimetre.

    Raises:
        InputFileError: if the file is missing or empty, or its first line is no calibration of the three cameras.
    """
    try:
        with opened(path) as file:
            row = msgspec.json.decode(file.readline(LONGEST_LINE), type=_CalibrationRow)
    except (FileNotFoundError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputFileError(shown(path), "line 1", expected="a calibration record", found=str(error)) from error
    for camera in row.cameras:
        quaternion = np.array([(camera.pose.quaternion[0], *camera.pose.quaternion[1])])
        require_poses(path, np.array([camera.pose.translation]), quaternion)
    poses = {camera.label: _transform(camera.pose) for camera in row.cameras}
    missing = {"camera-slam-left", "camera-slam-right", "camera-rgb"} - poses.keys()
    if missing:
        raise InputFileError(
            shown(path), "line 1", expected=f"the camera {min(missing)}", found=", ".join(sorted(poses))
        )
    return OnlineCalibration(row.tracking_timestamp_us, poses)


def _transform(pose: _Translation) -> np.ndarray:
    transform = np.eye(4)
    quaternion = (pose.quaternion[0], *pose.quaternion[1])
    transform[:3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    transform[:3, 3] = pose.translation
    return transform


def _read_wrists(found: RecordingFiles) -> tuple[mps.WristPositions | None, tuple[str, ...]]:
    """Wrists and palms: of the file made for them (10 Hz), else of the landmarks; None where neither is usable."""
    wrists = _file(found, mps.WRISTS)
    landmarks = _file(found, mps.HAND_TRACKING)
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


def read_wrists(path: Source) -> mps.WristPositions:
    """Read ``wrist_and_palm_poses.csv``, old or new.

    A hand counts as seen where its confidence is above 0 and its wrist is a number; where it was not, other columns
    may say -1 or 0.

    Raises:
        InputFileError: if the file or a column is missing, time runs backwards.
    """
    return _read(path, lambda side: _axes(f"{side}_wrist_device"), lambda side: _axes(f"{side}_palm_device"))


def _read(path: Source, wrist: _Columns, palm: _Columns) -> mps.WristPositions:
    confidences = tuple(f"{side}_tracking_confidence" for side in mps.SIDES)
    numbers = (*confidences, *(name for side in mps.SIDES for name in (*wrist(side), *palm(side))))
    table = read_columns(path, {mps.TIME_COLUMN: int, **dict.fromkeys(numbers, float)})
    time_us = table[mps.TIME_COLUMN].to_numpy()
    require_increasing(path, time_us, unit="us")
    wrists = _points(table, wrist)
    palms = _points(table, palm)
    confidence = np.nan_to_num(column_vectors(table, confidences), nan=0.0)
    # A hand without a wrist is not seen, whatever its confidence says.
    seen = (confidence > 0) & np.isfinite(wrists).all(axis=2)
    return mps.WristPositions(
        time_us,
        np.where(seen, confidence, np.minimum(confidence, 0.0)),
        np.where(seen[..., None], wrists, np.nan),
        np.where(seen[..., None], palms, np.nan),
    )


def _points(table: pa.Table, columns: _Columns) -> np.ndarray:
    return np.stack([column_vectors(table, columns(side)) for side in mps.SIDES], axis=1)


def _axes(name: str) -> tuple[str, ...]:
    return tuple(f"t{axis}_{name}" for axis in "xyz")


def read_hand_tracking(path: Source) -> mps.WristPositions:
    """Read wrists and palms of ``hand_tracking_results.csv``: landmarks 5 and 20 of 21.

    Raises:
        InputFileError: as :func:`read_wrists`.
    """
    return _read(
        path,
        lambda side: _axes(f"{side}_landmark_{mps.WRIST_LANDMARK}_device"),
        lambda side: _axes(f"{side}_landmark_{mps.PALM_LANDMARK}_device"),
    )
