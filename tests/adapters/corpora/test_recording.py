"""Nymeria's windows: gaze in the suit's world, and tables built from files."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.engine import InProcess
from prbench.errors import InputFileError, UsageError
from prbench.geometry.skeleton import XSENS_SEGMENTS, y_up
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps import format as mps
from prbench_adapters.corpora.nymeria.recording import gaze_in_suit_world, plan_windows
from prbench_adapters.corpora.nymeria.suit import clean_suit
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.table import WindowsTable
from prbench_benchmarks.motion_prediction.windows import build_windows
from tests.adapters.corpora.suits import START_US, walking_suit, write_arrays
from tests.readers.mps_files import COLUMNS, WORLD, write_lines

MOUNTED = Rotation.from_euler("xyz", [20.0, -70.0, 110.0], degrees=True)  # head from glasses
OTHER_WORLD = Rotation.from_euler("z", 40.0, degrees=True)  # the glasses' world has another heading


@pytest.fixture(scope="module")
def clean():
    suit = walking_suit(240 * 20)
    seconds = np.arange(len(suit.time_us)) / 240.0
    about = np.stack([0.4 * np.sin(2 * seconds), 0.6 * np.sin(1.3 * seconds + 1), 0.9 * np.sin(0.9 * seconds)], axis=1)
    rotation = suit.rotation.copy()
    rotation[:, XSENS_SEGMENTS.index("Head")] = Rotation.from_rotvec(about).as_quat(scalar_first=True)
    return clean_suit(replace(suit, rotation=rotation), load_manifest("nymeria"), path="xdata.npz")


def test_a_fixed_point_in_the_distance_is_seen_in_one_direction_of_the_suits_world(clean):
    piece = clean.pieces[0]
    times = piece.start + np.arange(0.0, 18.0, 0.1)
    frames = piece.first + np.floor((times - piece.start) * 240 + 1e-6).astype(int)
    head = Rotation.from_quat(clean.head_rotation[frames], scalar_first=True)
    # Straight ahead of the pupils in the first frame, Z up.
    ahead = mps.device_from_cpf("DVT-S")[:3, :3] @ [0.0, 0.0, 1.0]
    target = (head[0] * MOUNTED).apply(ahead)
    in_cpf = (head * MOUNTED).inv().apply(target) @ mps.device_from_cpf("DVT-S")[:3, :3]
    yaw, pitch = mps.gaze_angles(in_cpf)
    nothing = np.zeros(len(times))
    angles = mps.GazeAngles(
        (times * 1e6).astype(np.int64), yaw, pitch, nothing, np.zeros((len(times), 2)), np.zeros((len(times), 2))
    )
    directions, valid = gaze_in_suit_world(clean, Rotation.concatenate([MOUNTED] * len(times)), times, angles)
    assert 10 < valid.sum() < len(times)  # where the head turns away by more than 60 degrees nothing is measured
    assert np.allclose(directions[valid], y_up(target), atol=1e-6)
    assert np.allclose(directions[~valid], [0.0, 0.0, 1.0])


def test_gaze_outside_the_suits_time_is_not_measured(clean):
    piece = clean.pieces[0]
    times = np.array([piece.start - 1.0, piece.end + 1.0])
    none = np.zeros(2)
    angles = mps.GazeAngles(np.zeros(2, dtype=np.int64), none, none, none, np.zeros((2, 2)), np.zeros((2, 2)))
    _, valid = gaze_in_suit_world(clean, Rotation.concatenate([MOUNTED] * len(times)), times, angles)
    assert not valid.any()


NAME = "20230607_s0_james_johnson_act0_e72nhq"


def build_all(root, out, **changes):
    """Build windows of everything, and stop at the first error."""
    given = {"joints": None, "recordings": "*", "limit": None, "reader": ()} | changes
    plan = plan_windows("nymeria", root, **given)
    return build_windows(plan, out, on_error="fail", engine=InProcess(), progress=None)


@pytest.fixture
def root(tmp_path):
    folder = tmp_path / "nymeria" / NAME / "body"
    folder.mkdir(parents=True)
    write_arrays(folder / "xdata.npz", walking_suit(240 * 4))
    return tmp_path / "nymeria"


def test_a_suit_becomes_windows_on_the_22_joints_without_gaze_where_there_is_none(root, tmp_path):
    report = build_all(root, tmp_path / "w")
    assert (report.info.joint_set, report.info.has_gaze, report.info.outcomes) == ("smpl22", False, {"window": 3})
    table = WindowsTable.open(tmp_path / "w")
    assert table.runs["participant_id"].to_pylist() == ["james_johnson"]
    batch, truth = next(table.batches(Condition.POSE, table.chosen()))
    # The body glides at 0.8 m/s, and faces where it goes: +Z in the frame of its last pose.
    assert truth.joints[0, 29, 0, 2] == pytest.approx(0.8, abs=1e-3)
    with pytest.raises(UsageError, match="recorded gaze"):
        next(table.batches(Condition.POSE_GAZE, table.chosen()))
    assert batch.fps == 30.0


CLOCKS_APART = 2.5  # s that the suit's clock is ahead of the glasses'


def with_glasses(folder, suit):
    """Trajectory, gaze at 10 Hz on a far point, and the clocks' offset; returns the direction of that point, Y up."""
    seconds = (suit.time_us - START_US) / 1e6
    about = np.stack([0.2 * np.sin(2 * seconds), 0.3 * np.sin(1.3 * seconds + 1), 0.3 * np.sin(0.9 * seconds)], axis=1)
    head = Rotation.from_rotvec(about)
    rotation = suit.rotation.copy()
    rotation[:, XSENS_SEGMENTS.index("Head")] = head.as_quat(scalar_first=True)
    write_arrays(folder / "body" / "xdata.npz", replace(suit, rotation=rotation))
    glasses = (OTHER_WORLD * head * MOUNTED).as_quat(scalar_first=True)
    ridden = OTHER_WORLD.apply(suit.position[:, XSENS_SEGMENTS.index("Head")])
    times = suit.time_us - round(CLOCKS_APART * 1e6)
    lines = [",".join(COLUMNS)]
    for row in range(0, len(times), 2):
        cells = [WORLD, times[row], -1, *ridden[row], *glasses[row], 0.0, 0, 0, -9.81, 1.0, 0]
        lines.append(",".join(str(cell) for cell in cells))
    mps_folder = folder / "recording_head" / "mps"
    write_lines(mps_folder / "slam" / "closed_loop_trajectory.csv", lines)
    cpf = mps.device_from_cpf("DVT-S")[:3, :3]
    target = (head[0] * MOUNTED).apply(cpf @ [0.0, 0.0, 1.0])
    rows = np.arange(0, len(times), 24)
    yaw, pitch = mps.gaze_angles((Rotation.from_rotvec(about[rows]) * MOUNTED).inv().apply(target) @ cpf)
    gaze = [f"{mps.TIME_COLUMN},{mps.YAW},{mps.PITCH},{mps.DEPTH}"]
    gaze += [f"{times[row]},{yaw[place]},{pitch[place]}," for place, row in enumerate(rows)]
    write_lines(mps_folder / "eye_gaze" / "general_eye_gaze.csv", gaze)
    (folder / "time_offset.json").write_text(json.dumps({NAME: CLOCKS_APART}))
    return y_up(target)


def test_a_suit_with_glasses_becomes_windows_with_gaze_in_the_bodys_world(root, tmp_path):
    target = with_glasses(root / NAME, walking_suit(240 * 14))
    report = build_all(root, tmp_path / "w")
    assert report.info.has_gaze
    table = WindowsTable.open(tmp_path / "w")
    batch, _ = next(table.batches(Condition.POSE_GAZE, table.chosen(), frame="room"))
    assert len(batch) >= 20
    assert batch.gaze_valid is not None
    assert batch.gaze is not None
    assert batch.gaze_valid.mean() > 0.95
    assert np.allclose(batch.gaze[batch.gaze_valid], target, atol=2e-3)
    assert np.ptp(batch.observed_joints[:, -1, 0, 0]) > 5  # the body walks on meanwhile


def test_native_joints_and_names_that_do_not_exist_are_refused(root, tmp_path):
    with pytest.raises(UsageError, match="native"):
        build_all(root, tmp_path / "w", joints="native")
    with pytest.raises(InputFileError, match="matches 'x'"):
        build_all(root, tmp_path / "w", recordings="x")
