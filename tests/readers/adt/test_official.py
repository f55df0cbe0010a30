"""The official reader on the same files: the real sample, and a synthetic recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.readers.adt import find_recordings, read_readings, read_recording
from prbench.readers.adt import format as adt
from prbench.readers.aria_mps.format import device_from_cpf, gaze_directions_cpf
from prbench.recording import Recording

official = pytest.importorskip(
    "projectaria_tools.projects.adt",
    reason="the official reader is not installed: pip install 'prbench[official-readers]'",
)
sensor_data = pytest.importorskip("projectaria_tools.core.sensor_data")

CLOSEST = sensor_data.TimeQueryOptions.CLOSEST


class Both:
    """One recording through both readers."""

    def __init__(self, folder: Path) -> None:
        (found,) = find_recordings(folder)
        self.readings = read_readings(found)
        self.recording: Recording = read_recording(found)
        paths = official.AriaDigitalTwinDataPathsProvider(str(folder)).get_datapaths(True)
        self.official = official.AriaDigitalTwinDataProvider(paths)


@pytest.fixture(scope="module", params=["sample", "synthetic"])
def both(request, tmp_path_factory) -> Both:
    if request.param == "sample":
        return Both(request.getfixturevalue("samples") / "adt" / "aria_digital_twin_test_data")
    from prbench.readers.adt import synthetic as layout
    from prbench.readers.adt.synthetic import sense
    from prbench.synthetic.people import perform

    folder = tmp_path_factory.mktemp("synthetic") / "recording"
    layout.write(sense(perform("adt", seed=2, index=0, n_events=1)), folder)
    return Both(folder)


def _some(count: int) -> np.ndarray:
    """At most 200 rows spread over a stream, first and last included; every row of the sample."""
    return np.unique(np.linspace(0, count - 1, 200).astype(int))


def test_span_and_counts(both) -> None:
    times = both.readings.glasses.time_us
    assert both.official.get_start_time_ns() == times[0] * 1000
    assert both.official.get_end_time_ns() == times[-1] * 1000
    assert sorted(both.official.get_object_ids()) == [entry.object_id for entry in both.readings.objects]
    assert sorted(both.official.get_skeleton_ids()) == sorted(p.skeleton_id for p in both.readings.skeletons)


def test_poses_of_the_glasses(both) -> None:
    poses = both.readings.glasses
    for row in _some(len(poses.time_us)):
        answer = both.official.get_aria_3d_pose_by_timestamp_ns(int(poses.time_us[row]) * 1000, CLOSEST)
        assert answer.dt_ns() == 0
        expected = answer.data().transform_scene_device.to_matrix()
        assert poses.position[row] == pytest.approx(expected[:3, 3], abs=1e-6)
        matrix = Rotation.from_quat(poses.rotation[row], scalar_first=True).as_matrix()
        assert matrix == pytest.approx(expected[:3, :3], abs=1e-6)
        assert poses.quality[row] == pytest.approx(answer.data().quality_score, abs=1e-6)


def test_gaze_angles_and_rays(both) -> None:
    gaze, rays = both.readings.gaze, both.recording.gaze
    compared = 0
    for row in _some(len(gaze.time_us)):
        if not rays.valid[row]:
            continue
        answer = both.official.get_eyegaze_by_timestamp_ns(int(gaze.time_us[row]) * 1000, CLOSEST)
        assert answer.dt_ns() == 0
        assert [gaze.yaw[row], gaze.pitch[row]] == pytest.approx([answer.data().yaw, answer.data().pitch], abs=1e-6)
        assert gaze.depth[row] == pytest.approx(answer.data().depth, abs=1e-6)
        nearest = both.official.get_aria_3d_pose_by_timestamp_ns(int(gaze.time_us[row]) * 1000, CLOSEST)
        if nearest.data().quality_score == 0:
            continue  # ours then stands between the neighbours
        scene_cpf = nearest.data().transform_scene_device.to_matrix() @ device_from_cpf("DVT-L")
        direction = gaze_directions_cpf(gaze.yaw[row : row + 1], gaze.pitch[row : row + 1])[0]
        assert rays.origin[row] == pytest.approx(scene_cpf[:3, 3], abs=1e-4)  # 3 to 19 us of walking
        assert rays.direction[row] == pytest.approx(scene_cpf[:3, :3] @ direction, abs=1e-4)
        compared += 1
    assert compared >= 5


def test_object_poses_and_boxes(both) -> None:
    times = next(entry.time_ns for entry in both.readings.objects if entry.dynamic)
    for row in _some(len(times))[:: 1 + len(times) // 20]:
        answers = both.official.get_object_3d_boundingboxes_by_timestamp_ns(int(times[row]), CLOSEST)
        assert answers.dt_ns() == 0
        boxes = answers.data()
        for track in both.recording.objects:
            expected = boxes[int(track.object_id)]
            position, rotation = track.pose_at(times[row : row + 1] / 1e9)
            pose = expected.transform_scene_object.to_matrix()
            assert position[0] == pytest.approx(pose[:3, 3], abs=1e-6)
            assert Rotation.from_quat(rotation[0], scalar_first=True).as_matrix() == pytest.approx(
                pose[:3, :3], abs=1e-6
            )
            bounds = np.reshape(expected.aabb, (3, 2))
            assert track.box_min == pytest.approx(bounds[:, 0], abs=1e-6)
            assert track.box_max == pytest.approx(bounds[:, 1], abs=1e-6)


def test_names_categories_and_motion_types(both) -> None:
    tracks = {track.object_id: track for track in both.recording.objects}
    for entry in both.readings.objects:
        info = both.official.get_instance_info_by_id(entry.object_id)
        assert (info.name, info.category) == (entry.name, entry.category)
        assert (info.motion_type == official.MotionType.DYNAMIC) == entry.dynamic
    assert str(adt.SCENE_BOX_ID) not in tracks


def test_the_other_wearers_glasses_and_skeleton(tmp_path) -> None:
    from tests.readers.adt.test_files import two_wearers

    two_wearers(tmp_path)
    for found in find_recordings(tmp_path):
        readings, recording = read_readings(found), read_recording(found)
        paths = official.AriaDigitalTwinDataPathsProvider(str(found.folder)).get_datapaths(True)
        theirs = official.AriaDigitalTwinDataProvider(paths)
        assert sorted(theirs.get_skeleton_ids()) == sorted(person.skeleton_id for person in readings.skeletons)
        assert len(recording.other_people) == 1


def test_joints(both) -> None:
    (person,) = both.readings.skeletons
    for row in _some(len(person.time_ns)):
        answer = both.official.get_skeleton_by_timestamp_ns(int(person.time_ns[row]), person.skeleton_id, CLOSEST)
        assert answer.dt_ns() == 0
        assert person.joints[row] == pytest.approx(np.array(answer.data().joints), abs=1e-6)


def test_the_order_of_the_joints(both) -> None:
    assert tuple(official.AriaDigitalTwinSkeletonProvider.get_joint_labels()) == adt.JOINT_NAMES
