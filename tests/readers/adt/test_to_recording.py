"""The ADT reader on hand-made recordings: what it finds, what it leaves out, what it marks invalid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.readers.adt import find_recordings, read_readings, read_recording
from prbench.readers.adt import format as adt
from prbench.readers.adt import synthetic as layout
from prbench.readers.aria_mps.format import device_from_cpf
from prbench.recording import Recording, hold_neighbours
from tests.readers.conftest import FINGER_BASES, FORK, SOFA, STANDING, TABLE


def _through_files(readings: adt.AdtReadings, tmp_path: Path) -> Recording:
    layout.write(readings, tmp_path / readings.recording_id)
    return read_recording(find_recordings(tmp_path)[0])


def test_what_is_written_by_hand_comes_out(readings, tmp_path) -> None:
    recording = _through_files(readings, tmp_path)
    assert recording.span == (5000.0, 5001.0)
    assert recording.body is not None
    others = [joint for joint in Joint if joint != Joint.SPINE2]
    assert recording.body.joints[60, others] == pytest.approx(STANDING[others])
    assert recording.body.joints[0, Joint.SPINE2] == pytest.approx(
        (STANDING[Joint.SPINE1] + STANDING[Joint.SPINE3]) / 2
    )
    names = [(hand.side, hand.contact) for hand in recording.hands]
    contacts = ("wrist", "middle_finger_base")
    assert names == [(side, contact) for contact in contacts for side in ("left", "right")]
    for hand, point in zip(recording.hands, (*STANDING[20:], *FINGER_BASES), strict=True):
        assert hand.points[7, 0] == pytest.approx(point)
    assert float(TABLE) != TABLE
    assert str(TABLE) in {track.object_id for track in recording.objects}, "ids never pass through floats"
    fork = recording.object(str(FORK))
    assert fork.movable
    assert fork.times[0] == pytest.approx(5000.0000007, abs=1e-9)


def test_the_gaze_ray_starts_between_the_eyes_and_looks_along_z_of_the_cpf(readings, tmp_path) -> None:
    recording = _through_files(readings, tmp_path)
    turned = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])  # quaternion of the still life: 90 deg
    cpf = device_from_cpf("DVT-L")
    assert recording.gaze.origin[3] == pytest.approx(turned @ cpf[:3, 3] + (0.0, 1.6, 0.0))
    assert recording.gaze.direction[3] == pytest.approx(turned @ cpf[:3, 2])
    assert np.linalg.norm(recording.camera.position[3] - recording.head.position[3]) == pytest.approx(0.0589, abs=1e-3)


def test_the_room_is_left_out_by_id_and_by_size(readings, tmp_path) -> None:
    sofa = replace(readings.objects[1], object_id=SOFA, name="Hall", box_min=np.full(3, -2.0), box_max=np.full(3, 2.0))
    around = replace(sofa, position=np.array([[0.0, 1.6, 0.0]]))
    beside = replace(sofa, position=np.array([[5.0, 1.6, 0.0]]))
    for hall, expected in ((around, False), (beside, True)):
        recording = _through_files(replace(readings, objects=(*readings.objects, hall)), tmp_path / str(expected))
        ids = {track.object_id for track in recording.objects}
        assert (str(SOFA) in ids) == expected
        assert str(adt.SCENE_BOX_ID) not in ids


def test_gaze_is_invalid_without_angle_beyond_sixty_degrees_and_outside_the_tracked_time(readings, tmp_path) -> None:
    gaze = readings.gaze
    yaw, times = gaze.yaw.copy(), gaze.time_us.copy()
    yaw[4], yaw[5], yaw[6] = np.nan, np.deg2rad(61), np.deg2rad(59)
    times[-1] += 50_000
    recording = _through_files(replace(readings, gaze=replace(gaze, yaw=yaw, time_us=times)), tmp_path)
    assert np.flatnonzero(~recording.gaze.valid).tolist() == [4, 5, 30]
    assert np.isfinite(recording.gaze.direction).all()
    assert any("1 of 31 gaze rows lie outside" in message for message in recording.messages)


def test_poses_of_quality_0_are_invalid_and_gaze_takes_their_neighbours_only_within_50_ms(readings, tmp_path) -> None:
    quality = readings.glasses.quality.copy()
    quality[10] = 0.0
    recording = _through_files(replace(readings, glasses=replace(readings.glasses, quality=quality)), tmp_path)
    assert np.flatnonzero(~recording.head.valid).tolist() == [10]
    assert np.flatnonzero(~recording.gaze.valid).tolist() == [10], "its neighbours are 67 ms apart"


def test_implausible_body_frames_are_masked_and_hold_their_neighbours(readings, tmp_path) -> None:
    (person,) = readings.skeletons
    joints = person.joints.copy()
    joints[20] = 0.0
    joints[40, adt.JOINT_NAMES.index("LHand")] += 0.5
    joints[60, adt.MIDDLE_FINGER_BASES[1]] = 0.0
    recording = _through_files(replace(readings, skeletons=(replace(person, joints=joints),)), tmp_path)
    assert recording.body is not None
    assert np.flatnonzero(~recording.body.valid).tolist() == [20, 40]
    assert recording.body.joints[20] == pytest.approx(recording.body.joints[19])
    right_finger = recording.hand_streams("middle_finger_base")[1]
    assert np.flatnonzero(~right_finger.valid).tolist() == [20, 40, 60]
    assert recording.body.valid[60]


def test_fillers_come_from_the_nearest_valid_frame() -> None:
    values = np.array([[0.0], [1.0], [2.0], [3.0], [4.0], [5.0]])
    valid = np.array([False, True, False, False, True, False])
    assert hold_neighbours(values, valid)[:, 0].tolist() == [1, 1, 1, 4, 4, 4]
    assert not hold_neighbours(values, np.zeros(6, dtype=bool)).any()


@pytest.mark.parametrize(("twin", "group"), [("", "still_life"), ("a_twin", "a_twin"), ("z_twin", "still_life")])
def test_of_concurrent_twins_the_smaller_id_names_the_group_even_if_its_copy_is_absent(
    readings, tmp_path, twin, group
) -> None:
    assert _through_files(replace(readings, concurrent=twin), tmp_path).split_group == group


def test_objects_without_box_name_or_pose_are_left_out_and_counted(folder) -> None:
    path = folder / "3d_bounding_box.csv"
    path.write_text("\n".join(line for line in path.read_text().splitlines() if str(TABLE) not in line) + "\n")
    recording = read_recording(find_recordings(folder)[0])
    assert str(TABLE) not in {track.object_id for track in recording.objects}
    assert any(message.startswith("1 objects without") and str(TABLE) in message for message in recording.messages)


def test_an_online_calibration_tells_size_and_camera(folder, samples) -> None:
    (folder / "mps" / "slam").mkdir(parents=True)
    calibration = samples / "mps/mps_sample/trajectory/online_calibration.jsonl"
    (folder / "mps" / "slam" / "online_calibration.jsonl").write_bytes(calibration.read_bytes())
    (found,) = find_recordings(folder)
    readings, recording = read_readings(found), read_recording(found)
    assert readings.glasses_size == "DVT-S"
    assert readings.device_from_rgb is not None
    assert not any("assumed" in message for message in recording.messages)
    turned = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    assert recording.camera.position[0] == pytest.approx(turned @ readings.device_from_rgb[:3, 3] + (0.0, 1.6, 0.0))


def test_search_lists_every_input_with_its_size(folder) -> None:
    (found,) = find_recordings(folder.parent)
    assert (found.recording_id, found.folder) == ("still_life", folder.resolve())
    assert {file.path.name for file in found.files} == {path.name for path in folder.iterdir()}
    assert all(file.size == file.path.stat().st_size for file in found.files)
