"""The real sample through the reader, against values of the official reader (reference-values, ids ``adt-*``)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.shapes import slab_test
from prbench.geometry.timelines import nearest_index
from prbench.readers.adt import find_recordings, read_readings, read_recording
from prbench.readers.adt import format as adt
from prbench.readers.aria_mps.format import gaze_directions_cpf
from prbench.recording import ObjectTrack, Recording


@pytest.fixture(scope="module")
def readings(samples) -> adt.AdtReadings:
    return read_readings(find_recordings(samples / "adt" / "aria_digital_twin_test_data")[0])


@pytest.fixture(scope="module")
def recording(samples) -> Recording:
    return read_recording(find_recordings(samples / "adt")[0])


def test_span(recording, reference_values) -> None:
    expected = reference_values["adt-bounds"]["expect"]
    assert [round(time * 1e9 / 1000) * 1000 for time in recording.span] == [expected["start_ns"], expected["end_ns"]]


def test_counts(readings, recording, reference_values) -> None:
    expected = reference_values["adt-counts"]["expect"]
    wearer = readings.skeletons[0]
    assert len(readings.objects) == expected["objects"]
    assert sum(entry.dynamic for entry in readings.objects) == expected["dynamic"]
    assert sum(not entry.dynamic for entry in readings.objects) == expected["static"]
    assert len(readings.glasses.time_us) == expected["device_poses"]
    assert wearer.joints.shape == (expected["skeleton_frames"], expected["joints"], 3)
    assert len(recording.objects) == expected["objects"] - 1, "the room itself is left out"


def test_wearer(readings, recording, reference_values) -> None:
    expected = reference_values["adt-association"]["expect"]
    wearer = readings.skeletons[0]
    assert (wearer.name, wearer.skeleton_id, wearer.serial) == (expected["name"], expected["id"], expected["serial"])
    assert recording.participant_id == "T"
    assert recording.body is not None
    assert recording.body.valid.all()


def test_first_pose_of_the_glasses(readings, reference_values) -> None:
    expected = reference_values["adt-pose-0"]["expect"]
    pose = np.array(expected["T_scene_device"])
    assert readings.glasses.time_us[0] * 1000 == expected["time_ns"]
    assert readings.glasses.position[0] == pytest.approx(pose[:3, 3], abs=1e-6)
    matrix = Rotation.from_quat(readings.glasses.rotation[0], scalar_first=True).as_matrix()
    assert matrix == pytest.approx(pose[:3, :3], abs=1e-6)
    assert readings.glasses.quality[0] == pytest.approx(expected["quality"], abs=1e-6)


@pytest.mark.parametrize(("key", "time_ns"), [("WoodenBowl-2", 87551237566700), ("Hook_4-0", 87551170910700)])
def test_boxes(recording, reference_values, key, time_ns) -> None:
    expected = reference_values[f"adt-box-{key}"]["expect"]
    track = recording.object(str(expected["id"]))
    pose = np.array(expected["T_scene_object"])
    position, rotation = track.pose_at(np.array([time_ns / 1e9]))
    assert position[0] == pytest.approx(pose[:3, 3], abs=1e-6)
    assert Rotation.from_quat(rotation[0], scalar_first=True).as_matrix() == pytest.approx(pose[:3, :3], abs=1e-6)
    assert track.movable == (expected["motion_type"] == "dynamic")
    assert track.box_min == pytest.approx(expected["local_min"], abs=1e-6)
    assert track.box_max == pytest.approx(expected["local_max"], abs=1e-6)
    lower, upper = track.world_box(position, rotation)
    assert lower[0] == pytest.approx(expected["scene_min"], abs=1e-6)
    assert upper[0] == pytest.approx(expected["scene_max"], abs=1e-6)


@pytest.mark.parametrize("joint", ["Head", "Skeleton"])
def test_native_joints(readings, reference_values, joint) -> None:
    expected = reference_values[f"adt-joint-0-{joint}"]["expect"]
    wearer = readings.skeletons[0]
    assert wearer.time_ns[0] == expected["time_ns"]
    assert wearer.joints[0, adt.JOINT_NAMES.index(joint)] == pytest.approx(expected["position"], abs=1e-6)


def test_the_22_joints(recording, reference_values) -> None:
    expected = np.array(reference_values["adt-body22-5"]["expect"]["joints"])
    assert recording.body is not None
    assert recording.body.joints[5] == pytest.approx(expected, abs=1e-6)


def test_gaze_angles(readings, reference_values) -> None:
    expected = reference_values["adt-gaze-1"]["expect"]
    gaze = readings.gaze
    assert gaze.time_us[1] == expected["timestamp_us"]
    found = [gaze.yaw[1], gaze.pitch[1], gaze.depth[1]]
    assert found == pytest.approx([expected["yaw"], expected["pitch"], expected["depth_m"]], abs=1e-5)
    direction = gaze_directions_cpf(gaze.yaw, gaze.pitch)[1]
    assert direction == pytest.approx(expected["unit_vector_cpf"], abs=1e-5)


def test_gaze_ray_and_the_boxes_it_hits(recording, readings, reference_values) -> None:
    expected = reference_values["adt-gaze-world-2"]["expect"]
    origin, direction = recording.gaze.origin[2], recording.gaze.direction[2]
    assert origin == pytest.approx(expected["origin"], abs=0.003)
    assert direction == pytest.approx(expected["direction"], abs=0.001)
    entries = {
        track.name: _entry_distance(track, recording.gaze.times[2], origin, direction) for track in recording.objects
    }
    hits = sorted((distance, name) for name, distance in entries.items() if np.isfinite(distance))
    assert [name for _, name in hits] == expected["hits"]
    assert [distance for distance, _ in hits] == pytest.approx(expected["entry_m"], abs=0.005)
    assert readings.gaze.depth[2] == pytest.approx(expected["depth_file_m"], abs=1e-5)


def test_hands_at_the_fork(recording, reference_values) -> None:
    expected = reference_values["adt-hand-fork"]["expect"]
    fork = next(track for track in recording.objects if track.name == "WoodenFork")
    for contact, key in (("wrist", "LHand"), ("middle_finger_base", "LMiddle1")):
        hand = next(stream for stream in recording.hand_streams(contact) if stream.side == "left")
        point = hand.points[nearest_index(hand.times, fork.times[:1])[0], 0]
        local = Rotation.from_quat(fork.rotation[0], scalar_first=True).inv().apply(point - fork.position[0])
        outside = np.maximum(np.maximum(fork.box_min - local, local - fork.box_max), 0.0)
        assert np.linalg.norm(outside) == pytest.approx(expected[key]["to_box_m"], abs=1e-4)
        assert np.linalg.norm(local) == pytest.approx(expected[key]["to_origin_m"], abs=1e-4)


def test_an_unknown_size_of_the_glasses_is_said(recording) -> None:
    assert any("DVT-L assumed" in message for message in recording.messages)


def _entry_distance(track: ObjectTrack, time: float, origin: np.ndarray, direction: np.ndarray) -> float:
    """Distance along the ray to the oriented box of one object: the slab test in the object's frame."""
    index = nearest_index(track.times, np.array([time]))[0]
    turn = Rotation.from_quat(track.rotation[index], scalar_first=True).inv()
    hits = slab_test(
        turn.apply(origin - track.position[index])[None],
        turn.apply(direction)[None],
        track.box_min[None],
        track.box_max[None],
    )
    return float(hits.near[0, 0]) if hits.hit[0, 0] else np.inf
