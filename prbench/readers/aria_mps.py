"""Files of the Aria Machine Perception Services, shared by the Aria datasets (``formats/aria-mps.md``)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.formats import aria_mps as mps
from prbench.formats.adt import GazeAngles
from prbench.readers.files import column_vectors, read_columns, read_header, require_increasing, require_poses


@dataclass(frozen=True)
class AriaTrajectory:
    """Poses of the glasses in one gravity-aligned world."""

    time_us: Int[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    """w x y z, device to world."""
    quality: Float[np.ndarray, " n"]
    up: Float[np.ndarray, "3"]
    """Unit vector against gravity, in the world."""
    graph_uids: tuple[str, ...]
    """World frames in the file, the one kept first; poses of the others are left out."""
    left_out: int
    """Rows without pose or of another world."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a user should know about the rows that were left out."""
        if not self.left_out:
            return ()
        others = len(self.graph_uids) - 1
        return (
            f"{self.left_out} poses of the glasses without a world or in one of {others} other worlds are left out",
        )


def read_trajectory(path: Path) -> AriaTrajectory:
    """Read ``closed_loop_trajectory.csv`` or ADT's ``aria_trajectory.csv``.

    Rows without pose (``UNDEFINED_ROW``) and rows of another world frame than the most frequent one are left out.

    Raises:
        InputFileError: if the file is missing or empty, a column is missing, a pose is no pose, or time runs backwards.
    """
    numbers = (*mps.POSITION_COLUMNS, *mps.ROTATION_COLUMNS, *mps.GRAVITY_COLUMNS, mps.QUALITY_COLUMN)
    table = read_columns(path, {mps.GRAPH_COLUMN: str, mps.TIME_COLUMN: int, **dict.fromkeys(numbers, float)})
    rotation = column_vectors(table, mps.ROTATION_COLUMNS)
    require_increasing(path, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    graphs, kept = _one_world(table)
    require_poses(path, column_vectors(table, mps.POSITION_COLUMNS), rotation, used=kept)
    if not kept.any():
        raise InputFileError(
            path,
            "",
            expected="at least one pose of the glasses",
            found="none",
            remedy="The recording has no ground truth; download it again.",
        )
    gravity = column_vectors(table, mps.GRAVITY_COLUMNS)[kept][0]
    return AriaTrajectory(
        time_us=table[mps.TIME_COLUMN].to_numpy()[kept],
        position=column_vectors(table, mps.POSITION_COLUMNS)[kept],
        rotation=rotation[kept],
        quality=table[mps.QUALITY_COLUMN].to_numpy()[kept],
        up=-gravity / np.linalg.norm(gravity),
        graph_uids=graphs,
        left_out=int((~kept).sum()),
    )


def read_gaze_angles(path: Path) -> GazeAngles:
    """Read one gaze file of any of the three schemas, told apart by columns (section 5).

    Two yaws (schema B) become one; bounds that a schema lacks are NaN, and so is a missing depth.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, or time runs backwards.
    """
    names = read_header(path)
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
            path, "", expected="gaze rows", found="none", remedy="Without gaze nothing is primed; download it again."
        )
    require_increasing(path, table[mps.TIME_COLUMN].to_numpy(), unit="us")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    unknown = np.full(len(table), np.nan)

    def pair(names: tuple[str, str]) -> np.ndarray:
        return np.column_stack([columns.get(name, unknown) for name in names])

    yaw = mps.combined_yaw(columns[mps.LEFT_YAW], columns[mps.RIGHT_YAW]) if two_eyes else columns[mps.YAW]
    yaw_range = (
        mps.combined_yaw(pair(mps.LEFT_YAW_RANGE), pair(mps.RIGHT_YAW_RANGE)) if two_eyes else pair(mps.YAW_RANGE)
    )
    return GazeAngles(
        columns[mps.TIME_COLUMN],
        yaw,
        columns[mps.PITCH],
        columns.get(mps.DEPTH, unknown),
        yaw_range,
        pair(mps.PITCH_RANGE),
    )


def find_gaze_file(folder: Path) -> Path | None:
    """The preferred gaze file of a folder, under its new or an old name; None if there is none."""
    return next((folder / name for name in mps.GAZE_FILES if (folder / name).is_file()), None)


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
    """Where the cameras sit on the glasses, at one instant."""

    time_us: int
    device_from_camera: dict[str, Float[np.ndarray, "4 4"]]
    """By label: ``camera-slam-left``, ``camera-slam-right``, ``camera-rgb``."""

    @property
    def slam_baseline(self) -> float:
        """Distance between the two SLAM cameras, metres; it tells the size of the glasses."""
        left, right = (self.device_from_camera[f"camera-slam-{side}"] for side in ("left", "right"))
        return float(np.linalg.norm(left[:3, 3] - right[:3, 3]))

    @property
    def size(self) -> mps.GlassesSize:
        """Size of the glasses."""
        return mps.glasses_size(self.slam_baseline)


def read_first_calibration(path: Path) -> OnlineCalibration:
    """Read the first record of ``online_calibration.jsonl``; later ones differ by fractions of a millimetre.

    Raises:
        InputFileError: if the file is missing or empty, or its first line is no calibration of the three cameras.
    """
    try:
        with open(path, "rb") as file:
            row = msgspec.json.decode(file.readline(), type=_CalibrationRow)
    except (FileNotFoundError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputFileError(path, "line 1", expected="a calibration record", found=str(error)) from error
    for camera in row.cameras:
        quaternion = np.array([(camera.pose.quaternion[0], *camera.pose.quaternion[1])])
        require_poses(path, np.array([camera.pose.translation]), quaternion)
    poses = {camera.label: _transform(camera.pose) for camera in row.cameras}
    missing = {"camera-slam-left", "camera-slam-right", "camera-rgb"} - poses.keys()
    if missing:
        raise InputFileError(path, "line 1", expected=f"the camera {min(missing)}", found=", ".join(sorted(poses)))
    return OnlineCalibration(row.tracking_timestamp_us, poses)


def _transform(pose: _Translation) -> np.ndarray:
    transform = np.eye(4)
    quaternion = (pose.quaternion[0], *pose.quaternion[1])
    transform[:3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    transform[:3, 3] = pose.translation
    return transform


def _one_world(table: pa.Table) -> tuple[tuple[str, ...], np.ndarray]:
    """World frames of a trajectory, most frequent first, and the rows of the first."""
    encoded = table[mps.GRAPH_COLUMN].combine_chunks().dictionary_encode()
    names, codes = encoded.dictionary.to_pylist(), encoded.indices.to_numpy(zero_copy_only=False)
    counts = {name: int((codes == code).sum()) for code, name in enumerate(names) if name != mps.UNDEFINED_GRAPH}
    ranked = tuple(sorted(counts, key=lambda name: -counts[name]))
    kept = codes == names.index(ranked[0]) if ranked else np.zeros(len(codes), dtype=bool)
    return ranked, kept
