"""Files of the Machine Perception Services (docs/specification/aria-mps.md), as HOT3D and HD-EPIC hold them.

The CSV files of all datasets that were recorded with Aria glasses are written here.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_path, write_json
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.synthetic_sensors import GRAVITY

_ROLES = (
    mps.TRAJECTORY,
    mps.GAZE,
    mps.CALIBRATION,
    mps.WRISTS,
    mps.SLAM_SUMMARY,
    mps.GAZE_SUMMARY,
    mps.HAND_SUMMARY,
)
_ROTATION_AS_WRITTEN = ("qx_world_device", "qy_world_device", "qz_world_device", "qw_world_device")
_SCALAR_LAST = (1, 2, 3, 0)
_VELOCITY = tuple(f"device_linear_velocity_{axis}_device" for axis in "xyz")
_TURNING = tuple(f"angular_velocity_{axis}_device" for axis in "xyz")
_EYES = {"tx_left_eye_cpf": 0.0315, "tx_right_eye_cpf": -0.0315}
_NO_SESSION = "00000000-0000-0000-0000-000000000000"
_CAMERAS = {"camera-slam-left": (0.0, 0.0, 0.0), "camera-slam-right": (0.006, -0.138, 0.0)}
"""Where the SLAM cameras sit, metres; their distance tells the size of the glasses."""
_LARGE_GLASSES = 0.1427 / 0.1381
_CALIBRATION_STEP_US = 1_000_000


def write_mps(readings: mps.MpsReadings, folder: Path, *, only: Collection[str] | None = None) -> None:
    """Write ``slam/``, ``eye_gaze/`` and ``hand_tracking/`` below a folder.

    Args:
        readings: All that the files say; whole, not thinned.
        folder: The root of one recording's outputs.
        only: Roles (:data:`_ROLES`) to write; all if None.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    wanted = set(_ROLES if only is None else only)
    slam, gaze, hands = (folder / name for name in (mps.SLAM_FOLDER, mps.GAZE_FOLDER, mps.HAND_FOLDER))
    if mps.TRAJECTORY in wanted:
        write_csv(slam / mps.TRAJECTORY_FILE, _trajectory_columns(readings.trajectory))
    if mps.CALIBRATION in wanted and readings.glasses_size is not None:
        _write_calibration(slam / mps.CALIBRATION_FILE, readings)
    if mps.SLAM_SUMMARY in wanted:
        write_json(slam / mps.SUMMARY_FILE, {"SLAM": {"status": "SUCCESS", "info": [], "warnings": [], "errors": []}})
    if mps.GAZE in wanted:
        write_csv(gaze / f"{readings.gaze_kind}_eye_gaze.csv", _gaze_columns(readings.gaze))
    if mps.GAZE_SUMMARY in wanted:
        write_json(gaze / mps.SUMMARY_FILE, {"GazeInference": {"status": "SUCCESS", "message": ""}, "version": "3.0"})
    if mps.WRISTS in wanted and readings.wrists is not None:
        write_csv(hands / mps.WRISTS_FILE, _wrist_columns(readings.wrists))
    if mps.HAND_SUMMARY in wanted and readings.wrists is not None:
        write_json(hands / mps.SUMMARY_FILE, {"HandTracking": {"status": "SUCCESS", "message": ""}})


def _trajectory_columns(trajectory: mps.AriaTrajectory) -> dict[str, object]:
    n = len(trajectory.time_us)
    velocity, turning = _velocities(trajectory)
    return {
        mps.GRAPH_COLUMN: np.full(n, trajectory.graph_uids[0]),
        mps.TIME_COLUMN: trajectory.time_us,
        "utc_timestamp_ns": np.full(n, -1),
        **split_columns(mps.POSITION_COLUMNS, trajectory.position),
        **split_columns(_ROTATION_AS_WRITTEN, trajectory.rotation[:, list(_SCALAR_LAST)]),
        **split_columns(_VELOCITY, velocity),
        **split_columns(_TURNING, turning),
        **split_columns(mps.GRAVITY_COLUMNS, np.tile(GRAVITY, (n, 1))),
        mps.QUALITY_COLUMN: trajectory.quality,
        "geo_available": np.zeros(n, dtype=np.int64),
        **{f"t{axis}_ecef_device": np.zeros(n) for axis in "xyz"},
        **{f"q{axis}_ecef_device": np.full(n, float(axis == "w")) for axis in "xyzw"},
    }


def _velocities(trajectory: mps.AriaTrajectory) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return linear (m/s) and angular (rad/s) velocity in the device frame, between neighbouring rows."""
    rotation = Rotation.from_quat(trajectory.rotation, scalar_first=True)
    if len(rotation) < 2:
        return np.zeros((len(rotation), 3)), np.zeros((len(rotation), 3))
    step = np.diff(trajectory.time_us)[:, None] / 1e6
    linear = rotation[:-1].inv().apply(np.diff(trajectory.position, axis=0) / step)
    angular = (rotation[:-1].inv() * rotation[1:]).as_rotvec() / step
    return np.round(np.vstack([linear, linear[-1:]]), 6), np.round(np.vstack([angular, angular[-1:]]), 6)


def _gaze_columns(gaze: mps.GazeAngles) -> dict[str, object]:
    """Return columns in the schema of two eyes, which here look in parallel."""
    yaw = np.round(gaze.yaw, 6)
    yaw_range = np.round(gaze.yaw_range, 6)
    n = len(yaw)
    return {
        mps.TIME_COLUMN: gaze.time_us,
        mps.LEFT_YAW: yaw,
        mps.RIGHT_YAW: yaw,
        mps.PITCH: gaze.pitch,
        mps.DEPTH: gaze.depth,
        mps.LEFT_YAW_RANGE[0]: yaw_range[:, 0],
        mps.RIGHT_YAW_RANGE[0]: yaw_range[:, 0],
        mps.PITCH_RANGE[0]: gaze.pitch_range[:, 0],
        mps.LEFT_YAW_RANGE[1]: yaw_range[:, 1],
        mps.RIGHT_YAW_RANGE[1]: yaw_range[:, 1],
        mps.PITCH_RANGE[1]: gaze.pitch_range[:, 1],
        **{
            f"t{axis}_{side}_eye_cpf": np.full(n, _EYES.get(f"t{axis}_{side}_eye_cpf", 0.0))
            for side in mps.SIDES
            for axis in "xyz"
        },
        "session_uid": np.full(n, _NO_SESSION),
    }


def _wrist_columns(wrists: mps.WristPositions) -> dict[str, object]:
    columns: dict[str, object] = {mps.TIME_COLUMN: wrists.time_us}
    for index, side in enumerate(mps.SIDES):
        columns[f"{side}_tracking_confidence"] = wrists.confidence[:, index]
        for part, points in (("wrist", wrists.wrist), ("palm", wrists.palm)):
            names = [f"t{axis}_{side}_{part}_device" for axis in "xyz"]
            columns |= split_columns(names, np.nan_to_num(points[:, index], nan=0.0))
    return columns


def _write_calibration(path: Path, readings: mps.MpsReadings) -> None:
    first, last = readings.trajectory.time_us[[0, -1]]
    cameras = _camera_records(readings)
    imus = [_imu_record(label) for label in ("imu-right", "imu-left")]
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        for time_us in range(int(first), int(last) + 1, _CALIBRATION_STEP_US):
            record = {
                "utc_timestamp_ns": -1,
                "tracking_timestamp_us": time_us,
                "ImuCalibrations": imus,
                "CameraCalibrations": cameras,
            }
            file.write(msgspec.json.encode(record) + b"\n")


def _camera_records(readings: mps.MpsReadings) -> list[dict[str, object]]:
    scale = _LARGE_GLASSES if readings.glasses_size == "DVT-L" else 1.0
    poses = {label: _from_translation(np.array(place) * scale) for label, place in _CAMERAS.items()}
    if readings.device_from_rgb is not None:
        poses["camera-rgb"] = readings.device_from_rgb
    return [
        {
            "Label": label,
            "Calibrated": True,
            "SerialNumber": "",
            "T_Device_Camera": _pose_record(pose),
            "Projection": {"Name": "FisheyeRadTanThinPrism", "Params": [*_intrinsics(label), *[0.0] * 12]},
        }
        for label, pose in poses.items()
    ]


def _from_translation(place: np.ndarray) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, 3] = place
    return transform


def _intrinsics(label: str) -> tuple[float, float, float]:
    """Return the focal length and principal point, pixels: 2880 x 2880 for RGB, 640 x 480 for SLAM."""
    return (1220.0, 1440.0, 1440.0) if label == "camera-rgb" else (242.0, 320.0, 240.0)


def _pose_record(pose: Float[np.ndarray, "4 4"]) -> dict[str, object]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()
    return {"Translation": pose[:3, 3].tolist(), "UnitQuaternion": [w, [x, y, z]]}


def _imu_record(label: str) -> dict[str, object]:
    unit = np.eye(3).tolist()
    bias = {"Name": "Constant", "Offset": [0.0, 0.0, 0.0]}
    turning = {
        "Name": "LinearGSensitivity",
        "RectificationMatrix": unit,
        "GSensitivityMatrix": np.zeros((3, 3)).tolist(),
    }
    return {
        "Label": label,
        "Calibrated": True,
        "SerialNumber": "",
        "Gyroscope": {"TimeOffsetSec_Device_Gyro": 0.0, "Bias": bias, "Model": turning},
        "Accelerometer": {
            "TimeOffsetSec_Device_Accel": 0.0,
            "Bias": bias,
            "Model": {"Name": "UpperTriagonalLinear", "RectificationMatrix": unit},
        },
        "T_Device_Imu": _pose_record(np.eye(4)),
    }


def split_columns(names: Sequence[str], columns: np.ndarray) -> dict[str, object]:
    """Return the columns of an array under their names."""
    return {name: columns[:, index] for index, name in enumerate(names)}


def write_csv(path: Path, columns: Mapping[str, object]) -> None:
    """Write a table: plain header, no quotes, empty cells for NaN.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write((",".join(columns) + "\n").encode())
        pyarrow.csv.write_csv(
            table, file, pyarrow.csv.WriteOptions(include_header=False, quoting_style="none", batch_size=65536)
        )
