"""MPS files against values of the official reader (reference-values, ids ``mps-*`` and ``cpf-*``)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.timelines import interpolate, slerp
from prbench.readers.aria_mps.files import read_first_calibration, read_gaze_angles, read_trajectory
from prbench.readers.aria_mps.format import AriaTrajectory, device_from_cpf, gaze_directions_cpf, glasses_size


@pytest.fixture(scope="module")
def trajectory(samples) -> AriaTrajectory:
    return read_trajectory(samples / "mps/mps_sample/trajectory/closed_loop_trajectory.csv")


def _matrix(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = Rotation.from_quat(rotation, scalar_first=True).as_matrix(), position
    return transform


def test_closed_loop_rows(trajectory, reference_values) -> None:
    expected = reference_values["mps-closed-count"]["expect"]
    assert len(trajectory.time_us) == expected["rows"]
    assert [trajectory.time_us[0], trajectory.time_us[-1]] == [expected["first_us"], expected["last_us"]]
    assert np.diff(trajectory.time_us).max() == expected["max_step_us"]
    assert len(trajectory.graph_uids) == expected["graph_uids"]


@pytest.mark.parametrize("row", [0, 2500])
def test_closed_loop_pose(trajectory, reference_values, row) -> None:
    expected = reference_values[f"mps-closed-pose-{row}"]["expect"]
    assert trajectory.time_us[row] == expected["timestamp_us"]
    assert _matrix(trajectory.position[row], trajectory.rotation[row]) == pytest.approx(
        np.array(expected["T_world_device"]), abs=1e-6
    )
    assert trajectory.quality[row] == pytest.approx(expected["quality_score"])
    assert trajectory.up == pytest.approx(-np.array(expected["gravity_world"]) / 9.81)


def test_interpolated_pose(trajectory, reference_values) -> None:
    expected = reference_values["mps-interp-155000000000"]["expect"]["T_world_device"]
    times, query = trajectory.time_us / 1e6, np.array([155.0])
    position, rotation = interpolate(times, trajectory.position, query), slerp(times, trajectory.rotation, query)
    assert _matrix(position[0], rotation[0]) == pytest.approx(np.array(expected), abs=1e-5)


@pytest.mark.parametrize(
    ("key", "row"), [("mps-gaze-old-10", 10), ("mps-gaze-new-5", 5), ("mps-gaze-gen2-0", 0)], ids=["A", "B", "C"]
)
def test_gaze_schemas(samples, reference_values, key, row) -> None:
    item = reference_values[key]
    gaze, expected = read_gaze_angles(samples / item["file"]), item["expect"]
    assert gaze.time_us[row] == expected["timestamp_us"]
    assert [gaze.yaw[row], gaze.pitch[row]] == pytest.approx([expected["yaw"], expected["pitch"]], abs=2e-5)
    if "unit_vector_cpf" in expected:
        vector = gaze_directions_cpf(gaze.yaw, gaze.pitch)[row]
        assert vector == pytest.approx(expected["unit_vector_cpf"], abs=2e-5)
    if "depth_file_m" in expected:
        assert gaze.depth[row] == pytest.approx(expected["depth_file_m"], abs=1e-6)
    if expected.get("has_depth") is False:
        assert np.isnan(gaze.depth[row]) or gaze.depth[row] == 0


@pytest.mark.parametrize("size", ["DVT-S", "DVT-L"])
def test_nominal_cpf(reference_values, size) -> None:
    expected = reference_values[f"cpf-{size}"]["expect"]["T_device_cpf"]
    assert device_from_cpf(size) == pytest.approx(np.array(expected), abs=1e-6)


def test_calibration_tells_the_size(samples, reference_values) -> None:
    expected = reference_values["mps-calib-0"]["expect"]
    calibration = read_first_calibration(samples / "mps/mps_sample/trajectory/online_calibration.jsonl")
    rgb = calibration["camera-rgb"]
    assert rgb == pytest.approx(np.array(expected["T_device_rgb"]), abs=1e-6)
    left, right = (calibration[f"camera-slam-{side}"][:3, 3] for side in ("left", "right"))
    assert np.linalg.norm(left - right) == pytest.approx(expected["slam_baseline_m"], abs=1e-6)
    assert glasses_size(np.linalg.norm(left - right)) == expected["size"]
