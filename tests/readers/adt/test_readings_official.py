"""The official reader on the same files: the real sample, and a synthetic recording."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.shapes import slab_test
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


def _official_boxes(both: Both, time_ns: int) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Object-from-scene transform and box corners by id, at the official reader's nearest object time."""
    answer = both.official.get_object_3d_boundingboxes_by_timestamp_ns(time_ns, CLOSEST).data()
    return {
        str(key): (np.linalg.inv(box.transform_scene_object.to_matrix()), *np.reshape(box.aabb, (3, 2)).T)
        for key, box in answer.items()
    }


def _entry(local_origin: np.ndarray, local_direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Where a ray enters a box, one slab after the other; inf if it misses."""
    near, far = -np.inf, np.inf
    for k in range(3):
        first, last = sorted(
            ((low[k] - local_origin[k]) / local_direction[k], (high[k] - local_origin[k]) / local_direction[k])
        )
        near, far = max(near, first), min(far, last)
    return near if near < far and far >= 0 else np.inf


def test_what_each_gaze_ray_hits_and_where(both) -> None:
    gaze, rays, tracks = both.readings.gaze, both.recording.gaze, both.recording.objects
    compared = 0
    for row in _some(len(gaze.time_us))[:: 1 + len(gaze.time_us) // 40]:
        time_ns = int(gaze.time_us[row]) * 1000
        nearest = both.official.get_aria_3d_pose_by_timestamp_ns(time_ns, CLOSEST).data()
        if not rays.valid[row] or nearest.quality_score == 0:
            continue
        eye = both.official.get_eyegaze_by_timestamp_ns(time_ns, CLOSEST).data()
        scene_cpf = nearest.transform_scene_device.to_matrix() @ device_from_cpf("DVT-L")
        looking = scene_cpf[:3, :3] @ gaze_directions_cpf(np.array([eye.yaw]), np.array([eye.pitch]))[0]
        boxes = _official_boxes(both, time_ns)
        for track in tracks:
            local_from_scene, low, high = boxes[track.object_id]
            local_origin = local_from_scene[:3, :3] @ scene_cpf[:3, 3] + local_from_scene[:3, 3]
            expected = _entry(local_origin, local_from_scene[:3, :3] @ looking, low, high)
            position, rotation = track.pose_at(rays.times[row : row + 1])
            turn = Rotation.from_quat(rotation, scalar_first=True).inv()
            hits = slab_test(
                turn.apply(rays.origin[row] - position),
                turn.apply(rays.direction[row]),
                track.box_min[None],
                track.box_max[None],
            )
            found = float(hits.near[0, 0]) if hits.hit[0, 0] else np.inf
            if np.isfinite(expected) != np.isfinite(found):
                grazes = abs(float(hits.far[0, 0] - hits.near[0, 0])) < 0.01
                assert grazes, f"row {row}, {track.name}: {expected} or {found}"
                continue
            assert found == pytest.approx(expected, abs=0.002), f"row {row}, {track.name}"
            compared += np.isfinite(expected)
    assert compared >= 5


def test_distances_of_wrists_and_finger_bases_to_what_moves(both) -> None:
    (person,) = both.readings.skeletons
    contacts = {"wrist": adt.WRIST_JOINTS, "middle_finger_base": adt.MIDDLE_FINGER_BASES}
    moving = [track for track in both.recording.objects if track.movable]
    boxes_at = cache(partial(_official_boxes, both))
    for row in _some(len(person.time_ns))[:: 1 + len(person.time_ns) // 20]:
        joints = both.official.get_skeleton_by_timestamp_ns(int(person.time_ns[row]), person.skeleton_id, CLOSEST)
        for contact, pair in contacts.items():
            for hand, index in zip(both.recording.hand_streams(contact), pair, strict=True):
                if not hand.valid[row]:
                    continue
                expected_point = np.array(joints.data().joints)[index]
                assert hand.points[row, 0] == pytest.approx(expected_point, abs=1e-6)
                for track in moving:
                    own_time = int(np.abs(track.times - hand.times[row]).argmin())
                    boxes = boxes_at(round(track.times[own_time] * 1e9))
                    local_from_scene, low, high = boxes[track.object_id]
                    local = local_from_scene[:3, :3] @ expected_point + local_from_scene[:3, 3]
                    expected = np.linalg.norm(local - np.clip(local, low, high))
                    turn = Rotation.from_quat(track.rotation[own_time], scalar_first=True).inv()
                    ours = turn.apply(hand.points[row, 0] - track.position[own_time])
                    outside = np.maximum(np.maximum(track.box_min - ours, ours - track.box_max), 0.0)
                    assert np.linalg.norm(outside) == pytest.approx(expected, abs=1e-5)


def test_the_other_wearers_glasses_and_skeleton(tmp_path) -> None:
    from tests.readers.adt.test_readings_rules import two_wearers

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
