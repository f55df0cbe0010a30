"""Find and read the files of the Machine Perception Services: by name, below a folder or in archives.

Sources: docs/specification/aria-mps.md#folder-tree and docs/specification/aria-mps.md#closed-loop-trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.arrays import require_column
from prbench.files.bounded import foreign_input, require
from prbench.limits import FARTHEST_POSITION, LARGEST_ANGLE, LONGEST_LINE
from prbench.readers import files as native
from prbench.readers.aria_mps import format as mps
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present

# Names of the file of each role, the preferred one first.
_ROLES: dict[str, tuple[str, ...]] = {
    mps.TRAJECTORY: (mps.TRAJECTORY_FILE,),
    mps.GAZE: mps.GAZE_FILES,
    mps.CALIBRATION: (mps.CALIBRATION_FILE,),
    mps.WRISTS: (mps.WRISTS_FILE,),
}
# Roles of the files that each summary speaks of; it lies beside one of them.
_SUMMARIES = {
    mps.SLAM_SUMMARY: (mps.TRAJECTORY, mps.CALIBRATION),
    mps.GAZE_SUMMARY: (mps.GAZE,),
    mps.HAND_SUMMARY: (mps.WRISTS,),
}
UNREADABLE = "unreadable archive: "  # Role of an archive that cannot be opened: this and its name.
_USUAL_FOLDERS = ("slam", "trajectory", "eye_gaze", "hand_tracking")


def find_mps_files(root: Path) -> tuple[InputFile, ...]:
    """Find the files of one recording, under their present or old names.

    Args:
        root: The folder of one recording's outputs, or a zip archive of it; in a folder, archives are looked into too.

    Returns:
        At most one file a role: of several with the best name that in one of the usual folders, then the one that lies
        highest, plain before archived. Nothing is required here.

    Raises:
        InputFileError: if ``root`` is an archive and damaged.
    """
    wanted = {name for names in _ROLES.values() for name in names} | {mps.SUMMARY_FILE}
    present: list[InputFile] = []
    unreadable = []
    for path in [root] if root.is_file() else sorted(root.rglob("*")):
        if path.name in wanted:
            present.append(input_file("", path))
        elif path == root or (path.suffix == ".zip" and path.is_file()):
            try:
                members = sorted(native.archive_members(path).items())
                present += [InputFile("", path, size, member) for member, size in members]
            except InputFileError:
                if path == root:
                    raise
                # One damaged archive does not hide the files beside it; reading names it where something is missing.
                unreadable.append(input_file(f"{UNREADABLE}{path.name}", path))
    found: dict[str, InputFile] = {}
    for role, names in _ROLES.items():
        if candidates := [file for file in present if _place(file).name in names]:
            best = min(candidates, key=lambda file: _rank(file, names))
            found[role] = InputFile(role, best.path, best.size, best.member)
    for role, companions in _SUMMARIES.items():
        folders = [_place(found[companion]).parent for companion in companions if companion in found]
        for file in reversed(present):
            if _place(file).name == mps.SUMMARY_FILE and _place(file).parent in folders:
                found[role] = InputFile(role, file.path, file.size, file.member)
    return (*found.values(), *unreadable)


def find_gaze_file(folder: Path) -> Path | None:
    """Find the preferred gaze file of a folder, under its new or an old name; None if there is none."""
    return next((folder / name for name in mps.GAZE_FILES if is_present(folder / name)), None)


def _place(file: InputFile) -> PurePosixPath:
    """Return the path of a file; an archive counts as a folder."""
    return PurePosixPath((file.path / file.member).as_posix())


def _rank(file: InputFile, names: Sequence[str]) -> tuple[int, bool, int, bool, str]:
    folder = _place(file).parent
    unusual = folder.name not in _USUAL_FOLDERS
    return names.index(_place(file).name), unusual, len(folder.parts), bool(file.member), str(folder)


def read_warnings(path: native.Source) -> tuple[str, ...]:
    """Read what the operators of a stream warn of; their names vary between versions, and none is required.

    Returns:
        One remark for each operator with the status WARNING.

    Raises:
        InputFileError: if the file is damaged, or an operator reports an ERROR: the stream is then not to be used.
    """
    summary = native.decode_json(path, object)
    warnings = []
    for operator, entry in summary.items() if isinstance(summary, dict) else ():
        for report in entry if isinstance(entry, list) else [entry]:  # some operators hold a list of reports
            if not isinstance(report, dict) or report.get("status") not in ("ERROR", "WARNING"):
                continue
            details = [report.get("message"), *report.get("errors", []), *report.get("warnings", [])]
            said = "; ".join(str(detail) for detail in details if detail)[:160]
            reason = f" ({said})" if said else ""
            expected = "no operator with the status ERROR"
            remedy = "The services could not compute this stream; leave the recording out, or request it again."
            is_whole = report["status"] != "ERROR"
            require(native.shown(path), (is_whole, str(operator), expected, f"ERROR{reason}", remedy))
            warnings.append(f"{native.shown(path).parent.name}: {operator} warns{reason}")
    return tuple(warnings)


_LIKE_DEGREES = "Such angles look like degrees, or are damaged; use the file as it was released."


class _Translation(msgspec.Struct):
    translation: tuple[float, float, float] = msgspec.field(name="Translation")
    quaternion: tuple[float, tuple[float, float, float]] = msgspec.field(name="UnitQuaternion")


class _Camera(msgspec.Struct):
    label: str = msgspec.field(name="Label")
    pose: _Translation = msgspec.field(name="T_Device_Camera")


class _CalibrationRow(msgspec.Struct):
    cameras: tuple[_Camera, ...] = msgspec.field(name="CameraCalibrations")


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
    files = {file.role: file for file in found.files}
    for role in (mps.TRAJECTORY, mps.GAZE):
        if role not in files:
            for archive in (file for file in found.files if file.role.startswith(UNREADABLE)):
                native.archive_members(archive.path)  # says what is wrong with it
            found.require(role, _REQUIRED[role])  # says what was looked for
    sources = {role: native.source_of(file) for role, file in files.items()}
    summaries = [sources[role] for role in (mps.SLAM_SUMMARY, mps.GAZE_SUMMARY) if role in sources]
    remarks = [remark for summary in summaries for remark in read_warnings(summary)]
    gaze = read_gaze_angles(sources[mps.GAZE])
    poses = sources[mps.TRAJECTORY]
    trajectory = read_near(poses, gaze.time_us) if thin else read_trajectory(poses)
    remarks += trajectory.remarks
    size, device_from_rgb = read_size_and_camera(sources.get(mps.CALIBRATION))
    wrists = None
    if mps.WRISTS in sources:
        try:
            remarks += read_warnings(sources[mps.HAND_SUMMARY]) if mps.HAND_SUMMARY in sources else ()
        except InputFileError as error:
            remarks.append(f"the hands are not used: {error}")
        else:
            wrists = read_wrists(sources[mps.WRISTS])
    kind = "personalized" if _place(files[mps.GAZE]).name in mps.PERSONALIZED_GAZE_FILES else "general"
    return mps.MpsReadings(trajectory, gaze, kind, wrists, size, device_from_rgb, tuple(remarks))


_NUMBERS = (*mps.POSITION_COLUMNS, *mps.ROTATION_COLUMNS, *mps.GRAVITY_COLUMNS, mps.QUALITY_COLUMN)
# Columns that are read; the velocities are unreliable and stay unread.
COLUMNS: dict[str, native.Column] = {mps.GRAPH_COLUMN: str, mps.TIME_COLUMN: int, **dict.fromkeys(_NUMBERS, float)}


def read_trajectory(source: native.Source) -> mps.AriaTrajectory:
    """Read ``closed_loop_trajectory.csv`` or ADT's ``aria_trajectory.csv``.

    Rows without pose (``UNDEFINED_ROW``) and rows of another world frame than the most frequent one are left out.

    Args:
        source: The file, plain or in an archive.

    Raises:
        InputFileError: if the file is missing or empty, a column is missing, a pose is no pose, or time runs backwards.
    """
    table = native.read_columns(source, COLUMNS)
    native.require_increasing(source, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    return _trajectory_of(source, table)


@foreign_input()
def require_up(
    place: Path | str, trajectory: mps.AriaTrajectory, up: tuple[float, float, float], *, within: float, remedy: str
) -> None:
    """Refuse a trajectory whose gravity points elsewhere than in the dataset's world.

    Args:
        place: What the message names.
        trajectory: Poses with the direction against gravity.
        up: That direction in the dataset's world.
        within: Largest length of the difference.
        remedy: What to do about another one.

    Raises:
        InputFileError: telling both directions.
    """
    is_up = np.linalg.norm(trajectory.up - np.array(up)) <= within
    found = f"up = {(np.round(trajectory.up, 3) + 0.0).tolist()}"
    expected = f"gravity along -{'XYZ'[up.index(1.0)]} (this dataset's world)"
    require(place, (is_up, "gravity columns of the trajectory", expected, found, remedy))


def read_near(source: native.Source, gaze_us: Int[np.ndarray, " n"], rate: float = mps.POSE_RATE) -> mps.AriaTrajectory:
    """Check every row, and keep those around the gaze times and a regular grid, as :func:`mps.thinned` chooses them.

    Rows without a world or of another one are left out after the choice, so that at the edge of such a stretch poses
    may be missing for one step of the grid. Memory holds a block of text and the rows that are kept.

    Args:
        source: The file, plain or in an archive.
        gaze_us: Gaze times, increasing, microseconds on the device clock.
        rate: Rate of the grid, Hz.

    Raises:
        InputFileError: as :func:`read_trajectory`.
    """
    kept: list[pa.Table] = []
    last = first_us = None
    newest_us = -(2**62)
    rows = 0
    for table in native.read_blocks(source, COLUMNS):
        if not len(table):
            continue
        # The last row of the block before joins in: it may lie before a wanted time of this block.
        known = table if last is None else pa.concat_tables([last.cast(table.schema), table])
        time_us = known[mps.TIME_COLUMN].to_numpy()
        line = rows + 2 - (last is not None)
        native.require_increasing(source, time_us, unit="us", first=line)
        has_world = pc.call_function("not_equal", [known[mps.GRAPH_COLUMN], pa.scalar(mps.UNDEFINED_GRAPH)])
        groups = (mps.POSITION_COLUMNS, mps.ROTATION_COLUMNS)
        position, rotation = (native.column_vectors(known, names) for names in groups)
        native.require_poses(source, position, rotation, used=has_world.to_numpy(zero_copy_only=False), first=line)
        first_us = int(time_us[0]) if first_us is None else first_us
        wanted = mps.wanted_times_us(gaze_us, first_us, int(time_us[-1]), rate, from_us=int(time_us[0]))
        # Rows that no block before has kept, copied without the text of their world: blocks are large.
        near = mps.rows_around(time_us, wanted[wanted <= time_us[-1]])
        near = near[time_us[near] > newest_us]
        newest_us = int(time_us[near[-1]]) if len(near) else newest_us
        encoded = known[mps.GRAPH_COLUMN].dictionary_encode()
        known = known.set_column(known.schema.get_field_index(mps.GRAPH_COLUMN), mps.GRAPH_COLUMN, encoded)
        kept.append(known.take(near))
        last = known.take([len(known) - 1])
        rows += len(table)
    if last is None:
        return read_trajectory(source)
    # The grid reaches beyond the last row, which therefore counts.
    beyond = [last] if last[mps.TIME_COLUMN][0].as_py() > newest_us else []
    return _trajectory_of(source, pa.concat_tables([*kept, *beyond]))


def _trajectory_of(source: native.Source, table: pa.Table) -> mps.AriaTrajectory:
    """Return the poses of one world in a table of :data:`COLUMNS`.

    Raises:
        InputFileError: if there is none, or a pose is no pose.
    """
    groups = (mps.POSITION_COLUMNS, mps.ROTATION_COLUMNS, mps.GRAVITY_COLUMNS)
    position, rotation, gravity = (native.column_vectors(table, names) for names in groups)
    # World frames of a trajectory, most frequent first, and the rows of the first.
    encoded = table[mps.GRAPH_COLUMN].dictionary_encode().unify_dictionaries().combine_chunks()
    names = encoded.dictionary.to_pylist()
    codes = encoded.indices.to_numpy(zero_copy_only=False)
    counts = {name: int((codes == code).sum()) for code, name in enumerate(names) if name != mps.UNDEFINED_GRAPH}
    # sorted() is stable: of two equally frequent worlds the one that comes first in the file.
    graphs = tuple(sorted(counts, key=lambda name: -counts[name]))
    kept = codes == names.index(graphs[0]) if graphs else np.zeros(len(codes), dtype=bool)
    native.require_poses(source, position, rotation, used=kept)
    expected = "at least one pose of the glasses"
    remedy = "The recording has no ground truth; download it again."
    require(native.shown(source), (kept.any(), "", expected, "none", remedy))
    # Gravity is a constant of a world, so that the first row of the kept one tells it.
    down = gravity[kept][0]
    up = -down / np.linalg.norm(down)
    rows = slice(None) if kept.all() else kept  # a copy of an hour is large
    time_us, quality = (table[name].to_numpy()[rows] for name in (mps.TIME_COLUMN, mps.QUALITY_COLUMN))
    return mps.AriaTrajectory(time_us, position[rows], rotation[rows], quality, up, graphs, int((~kept).sum()))


def read_gaze_angles(path: native.Source) -> mps.GazeAngles:
    """Read one gaze file of any of the three schemas, told apart by columns (docs/specification/aria-mps.md#eye-gaze).

    Two yaws (schema B) become one; bounds that a schema lacks are NaN, and so is a missing depth.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, or time runs backwards.
    """
    names = native.read_header(path)
    # Schema B has a yaw for each eye, the other two schemas have one for both.
    two_eyes = mps.YAW not in names and mps.LEFT_YAW in names
    yaws = (mps.LEFT_YAW, mps.RIGHT_YAW) if two_eyes else (mps.YAW,)
    ranges = (*mps.YAW_RANGE, *mps.LEFT_YAW_RANGE, *mps.RIGHT_YAW_RANGE, *mps.PITCH_RANGE)
    optional = [name for name in (*ranges, mps.DEPTH) if name in names]
    table = native.read_columns(path, {mps.TIME_COLUMN: int, **dict.fromkeys((*yaws, mps.PITCH, *optional), float)})
    remedy = "Without gaze nothing is primed; download it again."
    require(native.shown(path), (len(table) > 0, "", "gaze rows", "none", remedy))
    native.require_increasing(path, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    for name in (*yaws, mps.PITCH):  # their bounds steer no ray
        require_column(native.shown(path), name, columns[name], largest=LARGEST_ANGLE, unit="rad", remedy=_LIKE_DEGREES)
    if mps.DEPTH in columns:
        require_column(native.shown(path), mps.DEPTH, columns[mps.DEPTH], largest=FARTHEST_POSITION, unit="m")
    unknown = np.full(len(table), np.nan)

    def pair(names: tuple[str, str]) -> np.ndarray:
        return np.column_stack([columns.get(name, unknown) for name in names])

    if two_eyes:
        yaw = mps.combined_yaw(columns[mps.LEFT_YAW], columns[mps.RIGHT_YAW])
        yaw_range = mps.combined_yaw(pair(mps.LEFT_YAW_RANGE), pair(mps.RIGHT_YAW_RANGE))
    else:
        yaw = columns[mps.YAW]
        yaw_range = pair(mps.YAW_RANGE)
    depth = columns.get(mps.DEPTH, unknown)
    return mps.GazeAngles(columns[mps.TIME_COLUMN], yaw, columns[mps.PITCH], depth, yaw_range, pair(mps.PITCH_RANGE))


def read_size_and_camera(path: native.Source | None) -> tuple[mps.GlassesSize | None, Float[np.ndarray, "4 4"] | None]:
    """Read the size of the glasses, which the distance of the SLAM cameras tells, and the pose of the RGB camera.

    Raises:
        InputFileError: as :func:`read_first_calibration`.
    """
    if path is None:
        return None, None
    cameras = read_first_calibration(path)
    left, right = (cameras[f"camera-slam-{side}"] for side in ("left", "right"))
    return mps.glasses_size(float(np.linalg.norm(left[:3, 3] - right[:3, 3]))), cameras["camera-rgb"]


def read_first_calibration(path: native.Source) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Read the first record of ``online_calibration.jsonl``; later ones differ by fractions of a millimetre.

    Returns:
        Pose of every camera on the glasses, by label (``camera-slam-left``, ``camera-slam-right``, ``camera-rgb``).

    Raises:
        InputFileError: if the file is missing or empty, or its first line is no calibration of the three cameras.
    """
    try:
        with native.opened(path) as file:
            row = msgspec.json.decode(file.readline(LONGEST_LINE), type=_CalibrationRow)
    except (FileNotFoundError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputFileError(native.shown(path), "line 1", expected="a calibration record", found=str(error)) from error
    poses = {}
    for camera in row.cameras:
        quaternion = (camera.pose.quaternion[0], *camera.pose.quaternion[1])
        native.require_poses(path, np.array([camera.pose.translation]), np.array([quaternion]))
        poses[camera.label] = np.eye(4)
        poses[camera.label][:3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        poses[camera.label][:3, 3] = camera.pose.translation
    if missing := {"camera-slam-left", "camera-slam-right", "camera-rgb"} - poses.keys():
        found = ", ".join(sorted(poses))
        raise InputFileError(native.shown(path), "line 1", expected=f"the camera {min(missing)}", found=found)
    return poses


def read_wrists(path: native.Source) -> mps.WristPositions:
    """Read ``wrist_and_palm_poses.csv``, old or new; the palms stay unread.

    A hand counts as seen where its confidence is above 0 and its wrist is a number; where it was not, other columns
    may say -1 or 0.

    Raises:
        InputFileError: if the file or a column is missing, time runs backwards.
    """
    confidences = tuple(f"{side}_tracking_confidence" for side in mps.SIDES)
    axes = [tuple(f"t{axis}_{side}_wrist_device" for axis in "xyz") for side in mps.SIDES]
    kinds = {mps.TIME_COLUMN: int, **dict.fromkeys((*confidences, *axes[0], *axes[1]), float)}
    table = native.read_columns(path, kinds)
    time_us = table[mps.TIME_COLUMN].to_numpy()
    native.require_increasing(path, time_us, unit="us")
    wrists = np.stack([native.column_vectors(table, names) for names in axes], axis=1)
    confidence = np.nan_to_num(native.column_vectors(table, confidences), nan=0.0)
    # A hand without a wrist is not seen, whatever its confidence says.
    seen = (confidence > 0) & np.isfinite(wrists).all(axis=2)
    confidence = np.where(seen, confidence, np.minimum(confidence, 0.0))
    return mps.WristPositions(time_us, confidence, np.where(seen[..., None], wrists, np.nan))


# Times (ns), positions and rotations of one body.
Poses = tuple[Int[np.ndarray, " n"], native.Points, native.Rotations]


def read_poses_by_body(path: Path, body: type[int] | type[str], *, static_time: int | None = None) -> dict[Any, Poses]:
    """Read the poses of every body of a file, each in the order of time.

    Args:
        path: CSV with a header line.
        body: Type of the column that tells the body.
        static_time: Stands for a time in the only row of a body that never moves.

    Raises:
        InputFileError: if the file or a column is missing, a pose is no pose, or the clock of a body stands still (a
            repeated row) or runs backwards.
    """
    numbers = dict.fromkeys((*mps.OBJECT_POSITION, *mps.OBJECT_ROTATION), float)
    table = native.read_columns(path, {mps.OBJECT_ID: body, mps.OBJECT_TIME: int, **numbers})
    positions = native.column_vectors(table, mps.OBJECT_POSITION)
    rotations = native.column_vectors(table, mps.OBJECT_ROTATION)
    native.require_poses(path, positions, rotations)
    encoded = table[mps.OBJECT_ID].combine_chunks().dictionary_encode()
    codes = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    times = table[mps.OBJECT_TIME].to_numpy()
    # Sorted by body alone: rows of one body keep the order of the file, which must be that of time.
    order = np.argsort(codes, kind="stable")
    grouped = times[order]
    same_body = np.diff(codes[order]) == 0
    mixed = np.flatnonzero(same_body & ((grouped[:-1] == static_time) | (grouped[1:] == static_time)))
    if mixed.size:
        where = f"line {int(order[mixed[0] + 1]) + 2}"
        expected = f"one row of time {static_time} for an object that never moves, or rows with times"
        found = f"both, or two rows of time {static_time}, for one object"
        remedy = "Remove one of the rows, or download the file again."
        raise InputFileError(path, where, expected=expected, found=found, remedy=remedy)
    backwards = np.flatnonzero(same_body & (np.diff(grouped) <= 0))
    if backwards.size:
        later = backwards[0] + 1
        native.require_increasing(path, grouped[later - 1 : later + 1], unit="ns", first=int(order[later]) + 1)
    bounds = np.searchsorted(codes[order], np.arange(1, len(encoded.dictionary)))
    bodies = zip(encoded.dictionary.to_pylist(), np.split(order, bounds), strict=True) if len(table) else ()
    return {name: (times[rows], positions[rows], rotations[rows]) for name, rows in bodies}
