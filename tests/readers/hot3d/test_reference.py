"""The real Aria recording says what the reference values say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.curation.in_hand import contact_distance
from prbench.geometry.shapes import slab_test
from prbench.geometry.skeleton import z_up
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps.files import read_gaze_angles
from prbench.readers.hot3d import Hot3dOptions, find_recordings, read_readings
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.files import read_glb
from prbench.readers.hot3d.to_recording import match_clocks, object_track, recording_from_hot3d, umetrack_points
from prbench.recording import ObjectTrack, Recording

SIDES = {"Left": 0, "Right": 1}


@pytest.fixture(scope="module")
def found(samples) -> Any:
    return next(f for f in find_recordings(samples / "hot3d", Hot3dOptions()) if f.skip_reason is None)


@pytest.fixture(scope="module")
def readings(found) -> hot3d.Hot3dReadings:
    return read_readings(found)


@pytest.fixture(scope="module")
def recording(readings) -> Recording:
    return recording_from_hot3d(readings, load_manifest("hot3d"), dataset="hot3d")


def _object(readings: hot3d.Hot3dReadings, name: str) -> hot3d.Hot3dObject:
    return next(entry for entry in readings.objects if entry.name == name)


def _matrix(rows: hot3d.PoseRows, row: int) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_quat(rows.rotation[row], scalar_first=True).as_matrix()
    transform[:3, 3] = rows.position[row]
    return transform


def test_counts(readings, reference_values) -> None:
    expect = reference_values["hot3d-counts"]["expect"]
    assert sum(len(entry.rows.time_ns) for entry in readings.objects) == expect["rows"]
    assert len(readings.objects) == expect["objects"]
    times = readings.headset.time_ns
    assert len(times) == expect["timestamps"]
    assert (times[-1] - times[0]) / 1e9 == pytest.approx(expect["span_s"], abs=1e-6)
    assert len(readings.masks["object_pose_available"][0]) == expect["rgb_timestamps"]
    assert hot3d.first_of_pairs(times).sum() == expect["rgb_timestamps"], "each RGB row with the SLAM row after it"


def test_metadata_and_the_refusal_of_quest(samples, readings, reference_values) -> None:
    assert readings.participant_id == reference_values["hot3d-meta"]["expect"]["participant"]
    by_id = {f.recording_id: f.skip_reason for f in find_recordings(samples / "hot3d", Hot3dOptions())}
    quest = Path(reference_values["hot3d-reject-quest"]["file"]).parent.name
    assert "no gaze" in (by_id[quest] or "")


def test_headset_and_object_poses(readings, reference_values) -> None:
    expect = reference_values["hot3d-headset-0"]["expect"]
    assert readings.headset.time_ns[0] == expect["timestamp_ns"]
    assert _matrix(readings.headset, 0) == pytest.approx(np.array(expect["T_world_device"]), abs=1e-6)
    expect = reference_values["hot3d-object-coffee_pot-33"]["expect"]
    rows = _object(readings, "coffee_pot").rows
    (row,) = np.flatnonzero(rows.time_ns == expect["timestamp_ns"])
    assert _matrix(rows, int(row)) == pytest.approx(np.array(expect["T_world_object"]), abs=1e-6)


def test_box_of_the_keyboard(readings, reference_values) -> None:
    expect = reference_values["hot3d-box-keyboard-0"]["expect"]
    keyboard = _object(readings, "keyboard")
    track = object_track(keyboard, np.ones(len(keyboard.rows.time_ns), dtype=bool), 0.2)
    assert track.box_min == pytest.approx(expect["local_min"], abs=1e-5)
    assert track.box_max == pytest.approx(expect["local_max"], abs=1e-5)
    low, high = track.world_box(track.position[:1], track.rotation[:1])
    corners = z_up(np.stack([low[0], high[0]]))
    assert corners.min(axis=0) == pytest.approx(expect["world_min"], abs=1e-5)
    assert corners.max(axis=0) == pytest.approx(expect["world_max"], abs=1e-5)
    assert z_up((low + high) / 2)[0] == pytest.approx(expect["centre_world"], abs=1e-5)


def test_a_turned_and_shifted_node_is_applied(samples) -> None:
    """The mouse's vertices lie 4 cm to one side of what its node makes of them."""
    path = samples / "hot3d" / "object_library" / "265826671143948.glb"
    vertices = read_glb(path)[0]
    assert vertices.min(axis=0) == pytest.approx([-0.03583109, -0.02088579, -0.05559148], abs=1e-6)


def test_wrists(readings, reference_values) -> None:
    expect = reference_values["hot3d-wrist-0"]["expect"]
    for hand in readings.hands:
        assert hand.time_ns[0] == expect["timestamp_ns"]
        assert hand.position[0] == pytest.approx(expect[hand.side], abs=1e-6)


@pytest.mark.parametrize("side", SIDES)
def test_hand_vertices(readings, reference_values, side) -> None:
    expect = reference_values[f"hot3d-handmesh-0-{side}"]["expect"]
    rows, model = readings.hands[SIDES[side]], readings.hand_model
    vertices = umetrack_points(rows, model)[2][0]
    assert len(vertices) == expect["vertices"]
    assert vertices[0] == pytest.approx(expect["vertex_0"], abs=1e-6)
    assert vertices.mean(axis=0) == pytest.approx(expect["vertex_mean"], abs=1e-6)
    distance = {
        entry.name: np.linalg.norm(vertices - entry.rows.position[0], axis=1).min() for entry in readings.objects
    }
    nearest = min(distance, key=distance.__getitem__)
    assert nearest == expect["nearest_object"]
    assert distance[nearest] == pytest.approx(expect["nearest_distance_m"], abs=1e-5)


def test_the_in_hand_rule_on_the_real_hands(recording) -> None:
    """Coffee pot 2.7 to 3.4 cm from the left hand at all times; the white mug is near the right hand, but not held."""
    rule = load_manifest("hot3d").in_hand
    assert rule is not None

    def distances(name: str, side: str) -> np.ndarray:
        track = next(track for track in recording.objects if track.name == name)
        hand = next(hand for hand in recording.hand_streams("hand_vertex") if hand.side == side)
        seen = track.valid
        return contact_distance(hand, track, rule, track.times[seen], track.position[seen], track.rotation[seen])

    pot = distances("coffee_pot", "left")
    assert 0.026 < pot.min() <= pot.max() < 0.035
    assert distances("mug_white", "right") == pytest.approx(np.full(len(pot), 0.064), abs=0.001)


def test_clock_offset(readings, reference_values) -> None:
    expect = reference_values["hot3d-clock-offset"]["expect"]
    device, headset = readings.mps.trajectory, readings.headset
    glasses = hot3d.PoseRows(device.time_us * 1000, device.position, device.rotation)
    match = match_clocks(headset, glasses, recording="sample")
    assert match.matched == 68
    assert match.offset_ns == pytest.approx(expect["middle_ns"], abs=1.0)
    assert 2 * match.half_width_ns == pytest.approx(expect["high_ns"] - expect["low_ns"], abs=2.0)
    assert match.drift == 0.0


@pytest.mark.parametrize(("identity", "row", "general"), [("personalized-0", 0, False), ("general-5", 5, True)])
def test_gaze_in_the_world_of_the_objects(found, readings, recording, reference_values, identity, row, general) -> None:
    expect = reference_values[f"hot3d-gaze-{identity}"]["expect"]
    if general:
        other = found.path("gaze").with_name("general_eye_gaze.csv")
        readings = replace(readings, mps=replace(readings.mps, gaze=read_gaze_angles(other)))
        recording = recording_from_hot3d(readings, load_manifest("hot3d"), dataset="hot3d")
    assert readings.mps.gaze.time_us[row] == expect["timestamp_us"]
    gaze = recording.gaze
    assert gaze.times[row] == pytest.approx(expect["gt_time_ns"] / 1e9, abs=1.5e-4)
    assert z_up(gaze.origin)[row] == pytest.approx(expect["origin_world"], abs=1e-4)
    assert z_up(gaze.direction)[row] == pytest.approx(expect["direction_world"], abs=1e-4)
    tracks = [track for track in recording.objects if (track.box_min != track.box_max).any()]
    assert sorted(track.name for track in tracks if _hit(track, gaze, row)) == expect["aabb_hits"]
    puzzle = next(track for track in tracks if track.name == "puzzle_toy")
    low, high = _box(puzzle, float(gaze.times[row]))
    away = (low + high) / 2 - gaze.origin[row]
    distance = np.linalg.norm(np.cross(gaze.direction[row], away))
    assert distance == pytest.approx(expect["puzzle_toy_distance_m"], abs=4e-3)


def _box(track: ObjectTrack, time: float) -> tuple[np.ndarray, np.ndarray]:
    row = int(np.argmin(np.abs(track.times - time)))
    low, high = track.world_box(track.position[row : row + 1], track.rotation[row : row + 1])
    return low[0], high[0]


def _hit(track: ObjectTrack, gaze: Any, row: int) -> bool:
    low, high = _box(track, float(gaze.times[row]))
    return bool(slab_test(gaze.origin[row][None], gaze.direction[row][None], low[None], high[None]).hit[0, 0])
