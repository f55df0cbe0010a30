"""The official reader on the same files: the real samples, and synthetic ones as HOT3D and HD-EPIC hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import (
    find_mps_files,
    read_first_calibration,
    read_gaze_angles,
    read_near,
    read_trajectory,
    read_wrists,
)
from prbench.readers.aria_mps.to_recording import mps_streams

official = pytest.importorskip(
    "projectaria_tools.core.mps", reason="the official reader is not installed: pip install 'prbench[official-readers]'"
)

SYNTHETIC = ("hot3d", "hd-epic")


@pytest.fixture(scope="module", params=["mps_sample", "hot3d_sample", *SYNTHETIC])
def folder(request, tmp_path_factory) -> Path:
    if request.param == "mps_sample":
        return request.getfixturevalue("samples") / "mps" / "mps_sample"
    if request.param == "hot3d_sample":
        return request.getfixturevalue("samples") / "hot3d" / "Aria" / "P0003_c701bd11" / "mps"
    from prbench.readers.aria_mps.synthetic import sense_mps, write_mps
    from prbench.synthetic.people import perform

    target = tmp_path_factory.mktemp("synthetic") / request.param
    performance = perform(request.param, seed=4, index=0, n_events=1)
    jitter = 2 if request.param == "hd-epic" else 0
    write_mps(sense_mps(performance, start_us=123_456_789_012, gaze_kind="general", step_jitter_us=jitter), target)
    return target


def file_of(folder: Path, role: str) -> Path:
    path = {file.role: file.path for file in find_mps_files(folder)}.get(role)
    if path is None:
        pytest.skip(f"no {role} in {folder.name}")
    return path


def microseconds(duration) -> int:
    return round(duration.total_seconds() * 1e6)


def test_poses(folder) -> None:
    path = file_of(folder, mps.TRAJECTORY)
    theirs, ours = official.read_closed_loop_trajectory(str(path)), read_trajectory(path)
    assert len(theirs) == len(ours.time_us)
    for row in np.unique(np.linspace(0, len(theirs) - 1, 200).astype(int)):
        expected = theirs[row].transform_world_device.to_matrix()
        assert microseconds(theirs[row].tracking_timestamp) == ours.time_us[row]
        assert ours.position[row] == pytest.approx(expected[:3, 3], abs=1e-6)
        matrix = Rotation.from_quat(ours.rotation[row], scalar_first=True).as_matrix()
        assert matrix == pytest.approx(expected[:3, :3], abs=1e-6)
        assert ours.quality[row] == pytest.approx(theirs[row].quality_score)
        assert theirs[row].graph_uid == ours.graph_uids[0]
    assert ours.up == pytest.approx(-np.array(theirs[0].gravity_world) / 9.81)


def test_poses_interpolated_at_the_gaze_times(folder) -> None:
    """From the searched rows only, against the official interpolation over all of them."""
    path, gaze = file_of(folder, mps.TRAJECTORY), read_gaze_angles(file_of(folder, mps.GAZE))
    thin = read_near(path, gaze.time_us)
    readings = mps.MpsReadings(thin, gaze, "general", None, "DVT-S", None)
    found = mps_streams(readings, world_from_source=np.eye(4))
    theirs = official.read_closed_loop_trajectory(str(path))
    provider = official.MpsDataProvider(_paths(path))
    compared = 0
    for row in np.flatnonzero(found.gaze.valid)[:: 1 + len(gaze.time_us) // 50]:
        time_ns = int(gaze.time_us[row]) * 1000
        pose = provider.get_interpolated_closed_loop_pose(time_ns)
        if pose is None:
            continue
        world_cpf = pose.transform_world_device.to_matrix() @ mps.device_from_cpf("DVT-S")
        direction = mps.gaze_directions_cpf(gaze.yaw[row : row + 1], gaze.pitch[row : row + 1])[0]
        assert found.gaze.origin[row] == pytest.approx(world_cpf[:3, 3], abs=1e-5)
        assert found.gaze.direction[row] == pytest.approx(world_cpf[:3, :3] @ direction, abs=1e-5)
        compared += 1
    assert compared >= 5
    assert len(thin.time_us) < len(theirs) / 5


def _paths(trajectory: Path):
    paths = official.MpsDataPaths()
    paths.slam.closed_loop_trajectory = str(trajectory)
    return paths


def test_gaze(folder) -> None:
    path = file_of(folder, mps.GAZE)
    theirs, ours = official.read_eyegaze(str(path)), read_gaze_angles(path)
    assert len(theirs) == len(ours.time_us)
    for row, entry in enumerate(theirs):
        assert microseconds(entry.tracking_timestamp) == ours.time_us[row]
        if np.isnan(ours.yaw[row]):
            continue
        if entry.vergence.left_yaw or entry.vergence.right_yaw:
            yaw = np.arctan((np.tan(entry.vergence.left_yaw) + np.tan(entry.vergence.right_yaw)) / 2)
        else:
            yaw = entry.yaw
        assert [ours.yaw[row], ours.pitch[row]] == pytest.approx([float(yaw), entry.pitch], abs=1e-6)


def test_the_first_calibration(folder) -> None:
    path = file_of(folder, mps.CALIBRATION)
    theirs = official.read_online_calibration(str(path))[0]
    ours = read_first_calibration(path)
    cameras = {camera.get_label(): camera for camera in theirs.camera_calibs}
    assert cameras.keys() == ours.keys()
    for label, camera in cameras.items():
        assert ours[label] == pytest.approx(camera.get_transform_device_camera().to_matrix(), abs=1e-6)


@pytest.mark.filterwarnings("ignore:WristAndPalmPoses:UserWarning")
def test_wrists(folder) -> None:
    path = file_of(folder, mps.WRISTS)
    theirs, ours = official.hand_tracking.read_wrist_and_palm_poses(str(path)), read_wrists(path)
    assert len(theirs) == len(ours.time_us)
    seen = 0
    for row, entry in enumerate(theirs):
        assert microseconds(entry.tracking_timestamp) == ours.time_us[row]
        for side, hand in enumerate((entry.left_hand, entry.right_hand)):
            if hand is None or hand.confidence <= 0:
                assert np.isnan(ours.wrist[row, side]).all()
                continue
            seen += 1
            assert ours.confidence[row, side] == pytest.approx(hand.confidence, abs=1e-6)
            assert ours.wrist[row, side] == pytest.approx(hand.wrist_position_device, abs=1e-6)
    assert seen > 5
