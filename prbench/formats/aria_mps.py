"""Project Aria: geometry of the glasses, columns of the Machine Perception Services (``formats/aria-mps.md``).

``a_from_b`` maps coordinates of b into a. Device frame: left SLAM camera as built. Central pupil frame (CPF):
x left, y up, z forward, origin midway between the eyes. Camera frame: z along the optical axis.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

GlassesSize = Literal["DVT-S", "DVT-L"]

TIME_COLUMN = "tracking_timestamp_us"
GRAPH_COLUMN = "graph_uid"
POSITION_COLUMNS = ("tx_world_device", "ty_world_device", "tz_world_device")
ROTATION_COLUMNS = ("qw_world_device", "qx_world_device", "qy_world_device", "qz_world_device")
"""In the order w x y z; the files hold them scalar last."""
GRAVITY_COLUMNS = ("gravity_x_world", "gravity_y_world", "gravity_z_world")
QUALITY_COLUMN = "quality_score"
UNDEFINED_GRAPH = "UNDEFINED_ROW"

YAW, PITCH = "yaw_rads_cpf", "pitch_rads_cpf"
LEFT_YAW, RIGHT_YAW = "left_yaw_rads_cpf", "right_yaw_rads_cpf"
LEFT_YAW_RANGE = ("left_yaw_low_rads_cpf", "left_yaw_high_rads_cpf")
RIGHT_YAW_RANGE = ("right_yaw_low_rads_cpf", "right_yaw_high_rads_cpf")
YAW_RANGE = ("yaw_low_rads_cpf", "yaw_high_rads_cpf")
PITCH_RANGE = ("pitch_low_rads_cpf", "pitch_high_rads_cpf")
DEPTH = "depth_m"

GAZE_FILES = (
    "personalized_eye_gaze.csv",
    "calibrated_eye_gaze.csv",
    "general_eye_gaze.csv",
    "generalized_eye_gaze.csv",
    "eyegaze.csv",
)
"""Preferred first: a personalized file exists only where the recording held a calibration phase."""
CALIBRATION_FILE = "online_calibration.jsonl"
SUMMARY_FILE = "summary.json"

LONGEST_POSE_STEP = 0.05
"""Seconds; a longer step is a gap that is never bridged (choice)."""
WIDEST_GAZE_ANGLE = np.deg2rad(60.0)
"""A gaze angle beyond it is no measurement (choice; there is no validity column)."""
SLAM_BASELINE_LIMIT = 0.1404
"""Metres between the two SLAM cameras: shorter means DVT-S, longer DVT-L."""

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
    """Nominal pose of the central pupil frame on the glasses, from the CAD drawing (section 4)."""
    transform = np.eye(4)
    transform[:3, :3] = _DEVICE_FROM_CPF_ROTATION
    transform[:3, 3] = _CPF_IN_DEVICE[size]
    return transform


def cpf_from_rgb() -> Float[np.ndarray, "4 4"]:
    """Nominal pose of the RGB camera: left temple, 8 degrees down, mounted on its side (image x points down)."""
    cosine, sine = np.cos(_RGB_PITCH), np.sin(_RGB_PITCH)
    transform = np.eye(4)
    transform[:3, :3] = np.transpose([(0.0, -cosine, -sine), (1.0, 0.0, 0.0), (0.0, -sine, cosine)])
    transform[:3, 3] = _RGB_IN_CPF
    return transform


def glasses_size(slam_baseline: float) -> GlassesSize:
    """Size of the glasses from the distance between their SLAM cameras, metres."""
    return "DVT-S" if slam_baseline < SLAM_BASELINE_LIMIT else "DVT-L"


def gaze_directions_cpf(yaw: Float[np.ndarray, " n"], pitch: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Unit gaze vectors ``normalise(tan yaw, tan pitch, 1)`` in the central pupil frame.

    Args:
        yaw: Radians, positive looks left.
        pitch: Radians, positive looks up.
    """
    vectors = np.column_stack([np.tan(yaw), np.tan(pitch), np.ones_like(yaw)])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def gaze_angles(directions_cpf: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Yaw and pitch of gaze vectors in the central pupil frame: the inverse of :func:`gaze_directions_cpf`.

    Args:
        directions_cpf: Any length; z > 0 (in front of the face).
    """
    x, y, z = directions_cpf.T
    return np.arctan2(x, z), np.arctan2(y, z)


def combined_yaw(left: Float[np.ndarray, "*n"], right: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """One yaw for both eyes: ``atan((tan left + tan right) / 2)``."""
    return np.arctan((np.tan(left) + np.tan(right)) / 2)
