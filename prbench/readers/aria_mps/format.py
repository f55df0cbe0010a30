"""Project Aria: geometry of the glasses, columns of the Machine Perception Services (docs/specification/aria-mps.md).

``a_from_b`` maps coordinates of b into a. Device frame: left SLAM camera as built. Central pupil frame (CPF):
x left, y up, z forward, origin midway between the eyes. Camera frame: z along the optical axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

GlassesSize = Literal["DVT-S", "DVT-L"]
GazeKind = Literal["personalized", "general"]

TIME_COLUMN = "tracking_timestamp_us"
GRAPH_COLUMN = "graph_uid"
POSITION_COLUMNS = ("tx_world_device", "ty_world_device", "tz_world_device")
# Order w x y z; the files hold them scalar last.
ROTATION_COLUMNS = ("qw_world_device", "qx_world_device", "qy_world_device", "qz_world_device")
GRAVITY_COLUMNS = ("gravity_x_world", "gravity_y_world", "gravity_z_world")
QUALITY_COLUMN = "quality_score"
UNDEFINED_GRAPH = "UNDEFINED_ROW"
VELOCITY_COLUMNS = tuple(
    f"{quantity}_{axis}_device" for quantity in ("device_linear_velocity", "angular_velocity") for axis in "xyz"
)

# The tables of objects' poses that ADT and HOT3D have.
OBJECT_ID = "object_uid"
OBJECT_TIME = "timestamp[ns]"
OBJECT_POSITION = ("t_wo_x[m]", "t_wo_y[m]", "t_wo_z[m]")
OBJECT_ROTATION = ("q_wo_w", "q_wo_x", "q_wo_y", "q_wo_z")

YAW = "yaw_rads_cpf"
PITCH = "pitch_rads_cpf"
LEFT_YAW = "left_yaw_rads_cpf"
RIGHT_YAW = "right_yaw_rads_cpf"
LEFT_YAW_RANGE = ("left_yaw_low_rads_cpf", "left_yaw_high_rads_cpf")
RIGHT_YAW_RANGE = ("right_yaw_low_rads_cpf", "right_yaw_high_rads_cpf")
YAW_RANGE = ("yaw_low_rads_cpf", "yaw_high_rads_cpf")
PITCH_RANGE = ("pitch_low_rads_cpf", "pitch_high_rads_cpf")
DEPTH = "depth_m"

# Preferred first: a personalized file exists only where the recording held a calibration phase.
GAZE_FILES = (
    "personalized_eye_gaze.csv",
    "calibrated_eye_gaze.csv",
    "general_eye_gaze.csv",
    "generalized_eye_gaze.csv",
    "eyegaze.csv",
)
PERSONALIZED_GAZE_FILES = GAZE_FILES[:2]
TRAJECTORY_FILE = "closed_loop_trajectory.csv"
CALIBRATION_FILE = "online_calibration.jsonl"
WRISTS_FILE = "wrist_and_palm_poses.csv"
SUMMARY_FILE = "summary.json"
SLAM_FOLDER = "slam"
GAZE_FOLDER = "eye_gaze"
HAND_FOLDER = "hand_tracking"

# Roles of the files of one recording.
TRAJECTORY = "trajectory"
GAZE = "gaze"
CALIBRATION = "calibration"
WRISTS = "wrists"
SLAM_SUMMARY = "slam_summary"
GAZE_SUMMARY = "gaze_summary"
HAND_SUMMARY = "hand_summary"

SIDES = ("left", "right")

LONGEST_POSE_STEP = 0.05  # Seconds; a longer step is a gap that is never bridged (choice).
WIDEST_GAZE_ANGLE = np.deg2rad(60.0)  # A gaze angle beyond it is no measurement (choice; there is no validity column).
LEAST_QUALITY = 0.5  # A pose with a lower quality score is invalid (choice).
POSE_RATE = 30.0  # Hz; of the 1 kHz poses those around the gaze times and around a grid of this rate are read.
_SLAM_BASELINE_LIMIT = 0.1404  # Metres between the two SLAM cameras: shorter means DVT-S, longer DVT-L.

_DEVICE_FROM_CPF_ROTATION = (
    (-0.031860137, -0.998629532, -0.041520951),
    (0.793353401, 0.000000002, -0.608761350),
    (0.607927062, -0.052336008, 0.792266136),
)
_CPF_IN_DEVICE: dict[GlassesSize, tuple[float, float, float]] = {
    "DVT-S": (0.004952958, -0.049148368, -0.049185461),
    "DVT-L": (0.004993020, -0.051460090, -0.049949881),
}
_RGB_IN_CPF = (0.057, 0.007, 0.013)
_RGB_PITCH = np.deg2rad(8.0)  # optical axis below CPF z


def device_from_cpf(size: GlassesSize) -> Float[np.ndarray, "4 4"]:
    """Return the nominal pose of the central pupil frame on the glasses, from the CAD drawing.

    Source: docs/specification/aria-mps.md#device-frame-and-cameras.
    """
    transform = np.eye(4)
    transform[:3, :3] = _DEVICE_FROM_CPF_ROTATION
    transform[:3, 3] = _CPF_IN_DEVICE[size]
    return transform


def cpf_from_rgb() -> Float[np.ndarray, "4 4"]:
    """Return the nominal pose of the RGB camera: left temple, 8 degrees down, on its side (image x points down)."""
    cosine = np.cos(_RGB_PITCH)
    sine = np.sin(_RGB_PITCH)
    transform = np.eye(4)
    transform[:3, :3] = np.transpose([(0.0, -cosine, -sine), (1.0, 0.0, 0.0), (0.0, -sine, cosine)])
    transform[:3, 3] = _RGB_IN_CPF
    return transform


def glasses_size(slam_baseline: float) -> GlassesSize:
    """Return the size of the glasses from the distance between their SLAM cameras, metres."""
    return "DVT-S" if slam_baseline < _SLAM_BASELINE_LIMIT else "DVT-L"


def gaze_directions_cpf(yaw: Float[np.ndarray, " n"], pitch: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Return the unit gaze vectors ``normalise(tan yaw, tan pitch, 1)`` in the central pupil frame.

    Args:
        yaw: Radians, positive looks left.
        pitch: Radians, positive looks up.
    """
    vectors = np.column_stack([np.tan(yaw), np.tan(pitch), np.ones_like(yaw)])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def gaze_angles(directions_cpf: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return yaw and pitch of gaze vectors in the central pupil frame: the inverse of :func:`gaze_directions_cpf`.

    Args:
        directions_cpf: Any length; z > 0 (in front of the face).
    """
    x, y, z = directions_cpf.T
    return np.arctan2(x, z), np.arctan2(y, z)


def combined_yaw(left: Float[np.ndarray, "*n"], right: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return one yaw for both eyes: ``atan((tan left + tan right) / 2)``."""
    return np.arctan((np.tan(left) + np.tan(right)) / 2)


@dataclass(frozen=True)
class AriaTrajectory:
    """Poses of the glasses in one world; those of a file in a gravity-aligned one.

    Attributes:
        time_us: Device clock.
        rotation: w x y z, device to world.
        up: Unit vector against gravity, in the world; 0 where no file tells it.
        graph_uids: World frames in the file, the one kept first; poses of the others are left out.
        left_out: Rows without pose or of another world.
    """

    time_us: Int[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    quality: Float[np.ndarray, " n"]
    up: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    graph_uids: tuple[str, ...] = ()
    left_out: int = 0

    @property
    def remarks(self) -> tuple[str, ...]:
        """Tell the user about the rows that were left out."""
        if not self.left_out:
            return ()
        others = len(self.graph_uids) - 1
        said = f"{self.left_out} poses of the glasses without a world or in one of {others} other worlds are left out"
        return (said,)


@dataclass(frozen=True)
class GazeAngles:
    """Angles in the central pupil frame, radians.

    Attributes:
        depth: Metres from the central pupil frame to what is looked at; 0 or NaN where unknown.
        yaw_range: Lower and upper bound.
    """

    time_us: Int[np.ndarray, " n"]
    yaw: Float[np.ndarray, " n"]
    pitch: Float[np.ndarray, " n"]
    depth: Float[np.ndarray, " n"]
    yaw_range: Float[np.ndarray, "n 2"]
    pitch_range: Float[np.ndarray, "n 2"]


@dataclass(frozen=True)
class WristPositions:
    """Wrists of the left and the right hand in the device frame.

    Attributes:
        confidence: 0 or less where the hand was not seen.
        wrist: Metres; NaN where the hand was not seen.
        palm: Not read, only written.
    """

    time_us: Int[np.ndarray, " n"]
    confidence: Float[np.ndarray, "n 2"]
    wrist: Float[np.ndarray, "n 2 3"]
    palm: Float[np.ndarray, "n 2 3"] | None = None


@dataclass(frozen=True)
class MpsReadings:
    """Readings of one recording by the Machine Perception Services: the content of their files.

    Attributes:
        wrists: None where no file tells.
        glasses_size: None where no file tells.
        device_from_rgb: Calibrated pose of the RGB camera; None where no file tells.
        messages: Messages of reading the files.
    """

    trajectory: AriaTrajectory
    gaze: GazeAngles
    gaze_kind: GazeKind
    wrists: WristPositions | None
    glasses_size: GlassesSize | None
    device_from_rgb: Float[np.ndarray, "4 4"] | None
    messages: tuple[str, ...] = ()


def wanted_times_us(
    gaze_us: Int[np.ndarray, " n"], first_us: int, last_us: int, rate: float = POSE_RATE, *, from_us: int | None = None
) -> Int[np.ndarray, " m"]:
    """Return the times around which poses of the glasses are needed: the gaze times and a regular grid.

    Args:
        gaze_us: Gaze times, microseconds on the device clock; those outside of the stretch do not count.
        first_us: First time of the trajectory, where the grid begins.
        last_us: Last time of the stretch; the grid ends there or less than one step later.
        rate: Rate of the grid, Hz.
        from_us: Beginning of the stretch, which is left out itself; the first time by default, which is not.

    Returns:
        Sorted, without repetition.
    """
    begin = first_us - 1 if from_us is None or from_us == first_us else from_us
    step, stop = (int((time_us - first_us) * rate / 1e6) for time_us in (begin, last_us))
    grid = first_us + np.rint(np.arange(max(step - 1, 0), stop + 3) * (1e6 / rate)).astype(np.int64)
    grid = grid[: np.searchsorted(grid, last_us) + 1]
    times = np.unique(np.concatenate([gaze_us[gaze_us <= last_us], grid]))
    return times[times > begin]


def rows_around(time_us: Int[np.ndarray, " n"], wanted_us: Int[np.ndarray, " m"]) -> Int[np.ndarray, " k"]:
    """Return the rows on both sides of every wanted time: the last one before it, and the first one at or after it.

    Args:
        time_us: Time of every row, increasing; at least one.
        wanted_us: Any order; of a time outside of the rows the nearest row counts.

    Returns:
        Sorted row numbers, each once.
    """
    after = np.searchsorted(time_us, wanted_us)
    return np.unique(np.clip(np.concatenate([after - 1, after]), 0, len(time_us) - 1))


def thinned(readings: MpsReadings, rate: float = POSE_RATE) -> MpsReadings:
    """Return the readings with only those trajectory rows that lie around the gaze times and a regular grid.

    No step becomes longer than the grid's: gaps stay gaps, and nothing else becomes one.
    """
    whole = readings.trajectory
    wanted = wanted_times_us(readings.gaze.time_us, int(whole.time_us[0]), int(whole.time_us[-1]), rate)
    return replace(readings, trajectory=trajectory_rows(whole, rows_around(whole.time_us, wanted)))


def trajectory_rows(whole: AriaTrajectory, rows: Int[np.ndarray, " k"]) -> AriaTrajectory:
    """Return some rows of a trajectory."""
    columns = ("time_us", "position", "rotation", "quality")
    return replace(whole, **{name: getattr(whole, name)[rows] for name in columns})


def trajectory_columns(
    poses: AriaTrajectory, graph_uid: str, gravity: Sequence[float] | np.ndarray, velocities: np.ndarray | None
) -> dict[str, object]:
    """Return the columns of a file of poses: rotations scalar last, velocities (linear, then angular) if any."""
    n = len(poses.time_us)
    return {
        GRAPH_COLUMN: np.full(n, graph_uid),
        TIME_COLUMN: poses.time_us,
        "utc_timestamp_ns": np.full(n, -1),
        **split_columns(POSITION_COLUMNS, poses.position),
        **split_columns((*ROTATION_COLUMNS[1:], ROTATION_COLUMNS[0]), np.roll(poses.rotation, -1, axis=1)),
        **({} if velocities is None else split_columns(VELOCITY_COLUMNS, velocities)),
        **split_columns(GRAVITY_COLUMNS, np.tile(gravity, (n, 1))),
        QUALITY_COLUMN: poses.quality,
    }


def split_columns(names: Sequence[str], columns: np.ndarray) -> dict[str, object]:
    """Return the columns of an array under their names."""
    return dict(zip(names, columns.T, strict=True))
