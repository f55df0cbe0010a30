"""The skeleton: names of joints, headings, canonical frame, head-forward vector, Z up to Y up."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import (
    BONES,
    CHAINS,
    N_JOINTS,
    PARENTS,
    Y_UP_FROM_Z_UP,
    Joint,
    bone_lengths,
    canonical_frame,
    facing_yaw,
    head_forward,
    invert_rigid,
    match_names,
    normalised,
    transform_points,
    y_up,
    z_up,
)
from tests.metrics.motions import STANDING, random_motion, standing
from tests.readers.gimo_sample import skeleton


def yaw_matrix(yaw: float) -> np.ndarray:
    return Rotation.from_euler("y", yaw).as_matrix()


def leaning_head(tilt_deg: float) -> np.ndarray:
    """Standing, facing +Z, with the neck-head bone leaning forwards."""
    pose = STANDING.copy()
    tilt = np.deg2rad(tilt_deg)
    pose[Joint.HEAD] = pose[Joint.NECK] + 0.1 * np.array([0, np.cos(tilt), np.sin(tilt)])
    return pose


def test_chains_and_parents_describe_one_tree() -> None:
    assert PARENTS[0] == -1
    assert all(parent < child for parent, child in BONES)
    along_chains = {(a, b) for chain in CHAINS for a, b in pairwise(chain)}
    assert along_chains == set(BONES)
    for left, right in ((j, Joint[j.name.replace("LEFT", "RIGHT")]) for j in Joint if "LEFT" in j.name):
        assert PARENTS[right] - PARENTS[left] in (0, 1)


def test_joints_and_parents_are_those_of_the_reference_skeleton(samples: Path) -> None:
    reference = json.loads((samples / "humanml3d" / "skeleton.json").read_text())
    assert reference["parents"] == list(PARENTS)
    assert reference["chains"] == [list(chain) for chain in CHAINS]
    names = [joint.name.lower().replace("left_", "l_").replace("right_", "r_") for joint in Joint]
    assert reference["joint_names"] == names


def test_bone_lengths_in_the_order_of_the_bones() -> None:
    pose = np.zeros((2, N_JOINTS, 3))
    pose[1, Joint.RIGHT_WRIST] = (0.0, 0.3, 0.4)
    lengths = bone_lengths(pose)
    assert lengths.shape == (2, 21)
    assert lengths[1, BONES.index((Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST))] == pytest.approx(0.5)
    assert lengths.sum() == pytest.approx(0.5)


@given(yaw=st.floats(-3.14, 3.14))
def test_facing_yaw_is_the_turn_about_y(yaw: float) -> None:
    assert facing_yaw(STANDING @ yaw_matrix(yaw).T) == pytest.approx(yaw, abs=1e-9)


def test_facing_backwards_is_half_a_turn_and_plus_x_a_quarter() -> None:
    assert abs(facing_yaw(STANDING * (-1, 1, -1))) == pytest.approx(np.pi)
    assert facing_yaw(STANDING @ yaw_matrix(np.pi / 2).T) == pytest.approx(np.pi / 2)
    left_side_on_plus_x = STANDING[Joint.LEFT_HIP, 0] > 0
    assert left_side_on_plus_x
    assert facing_yaw(STANDING) == 0


def test_a_pose_on_a_vertical_line_has_no_heading() -> None:
    with pytest.raises(ValueError, match="no heading"):
        facing_yaw(STANDING * (0, 1, 0))


@given(seed=st.integers(0, 50), yaw=st.floats(-3.2, 3.2), x=st.floats(-9, 9), y=st.floats(-9, 9), z=st.floats(-9, 9))
def test_the_canonical_motion_is_the_same_wherever_it_was_recorded(seed, yaw, x, y, z) -> None:
    motion = random_motion(np.random.default_rng(seed), 20)

    def canonical(world: np.ndarray) -> np.ndarray:
        return transform_points(invert_rigid(canonical_frame(world)), world)

    here, there = canonical(motion), canonical(motion @ yaw_matrix(yaw).T + (x, y, z))
    np.testing.assert_allclose(there, here, atol=1e-9)
    np.testing.assert_allclose(here[0, Joint.PELVIS, [0, 2]], 0, atol=1e-12)
    assert here[..., 1].min() == pytest.approx(0, abs=1e-12)
    assert facing_yaw(here[0]) == pytest.approx(0, abs=1e-9)


def test_the_reference_canonical_motions_are_recognised_as_canonical(samples: Path) -> None:
    files = sorted((samples / "humanml3d" / "golden").glob("*.npz"))
    assert files
    for file in files:
        canonical = np.load(file, allow_pickle=False)["canonical"].astype(np.float64)
        if np.isfinite(canonical).all() and len(canonical) > 1:
            np.testing.assert_allclose(canonical_frame(canonical), np.eye(4), atol=5e-5, err_msg=file.name)


def test_a_rigid_transform_undoes_its_inverse() -> None:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = Rotation.random(rng=0).as_matrix(), (1, 2, 3)
    points = np.random.default_rng(0).normal(size=(5, 7, 3))
    there = transform_points(transform, points)
    np.testing.assert_allclose(there, points @ transform[:3, :3].T + transform[:3, 3], atol=1e-12)
    np.testing.assert_allclose(transform_points(invert_rigid(transform), there), points, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 7.4, 29.6, 38.3, -10.0])
def test_the_rest_pose_looks_ahead_when_the_tilt_is_that_of_its_bone(tilt: float) -> None:
    forward, degenerate = head_forward(leaning_head(tilt), tilt)
    np.testing.assert_allclose(forward, [0, 0, 1], atol=1e-12)
    assert not degenerate


def test_without_its_tilt_a_leaning_bone_looks_down() -> None:
    forward, _ = head_forward(leaning_head(30), 0.0)
    np.testing.assert_allclose(forward, [0, -0.5, np.cos(np.pi / 6)], atol=1e-12)


@given(seed=st.integers(0, 50), tilt=st.floats(-20, 40))
def test_head_forward_turns_with_the_world_and_has_unit_length(seed: int, tilt: float) -> None:
    motion = random_motion(np.random.default_rng(seed), 5)
    rotation = Rotation.random(rng=seed).as_matrix()
    here, degenerate = head_forward(motion, tilt)
    there, _ = head_forward(motion @ rotation.T + 3.0, tilt)
    assert not degenerate.any()
    np.testing.assert_allclose(there, here @ rotation.T, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(here, axis=-1), 1, atol=1e-12)


def test_each_pose_may_have_its_own_tilt() -> None:
    tilts = np.array([0.0, 10.0, 38.3])
    poses = np.stack([leaning_head(tilt) for tilt in tilts])
    np.testing.assert_allclose(head_forward(poses, tilts)[0], np.tile([0, 0, 1.0], (3, 1)), atol=1e-12)


def test_a_head_on_the_neck_takes_the_torso_as_vertical() -> None:
    pose = standing(3)
    pose[1, Joint.HEAD] = pose[1, Joint.NECK] + (0, 0.009, 0)
    pose[2, Joint.HEAD] = pose[2, Joint.NECK] + (0, 0, 0.009)
    forward, degenerate = head_forward(pose, 20.0)
    assert degenerate.tolist() == [False, True, True]
    np.testing.assert_allclose(forward[1:], [[0, 0, 1]] * 2, atol=1e-12)


def test_a_head_beside_the_shoulder_is_degenerate() -> None:
    for degrees, expected in [(5, True), (7, False)]:
        angle = np.deg2rad(degrees)
        pose = STANDING.copy()
        pose[Joint.HEAD] = pose[Joint.NECK] + 0.1 * np.array([np.cos(angle), np.sin(angle), 0])
        assert head_forward(pose, 7.4)[1] == expected, degrees


def test_a_pose_without_axes_has_no_direction_and_no_nan() -> None:
    on_a_point, on_a_line = np.zeros((22, 3)), np.linspace(0, 1, 22)[:, None] * np.array([0.3, 0.9, 0.1])
    for pose in (on_a_point, on_a_line):
        forward, degenerate = head_forward(pose, 7.4)
        assert degenerate
        np.testing.assert_allclose(forward, 0, atol=1e-9)


POINTS = np.random.default_rng(3).normal(size=(4, 5, 3))


def test_what_was_up_is_up_and_nothing_is_mirrored() -> None:
    np.testing.assert_array_equal(y_up(np.array([1.0, 2.0, 3.0])), [1.0, 3.0, -2.0])
    assert np.linalg.det(Y_UP_FROM_Z_UP[:3, :3]) == pytest.approx(1.0)


def test_points_and_matrix_are_the_same_turn() -> None:
    np.testing.assert_array_equal(y_up(POINTS), transform_points(Y_UP_FROM_Z_UP, POINTS))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_there_and_back_changes_no_bit(kind) -> None:
    points = POINTS.astype(kind)
    assert z_up(y_up(points)).dtype == kind
    np.testing.assert_array_equal(z_up(y_up(points)), points)


@pytest.mark.parametrize("name", ["LeftUpLeg", "left_up_leg", "Actor:L_UpLeg", "mixamorig:LeftUpLeg", "Left Up-Leg"])
def test_spellings_of_one_name_are_one(name) -> None:
    assert normalised(name) == "leftupleg"


def test_shoulder_means_collar_or_shoulder_by_the_names_beside_it() -> None:
    sides = [
        f"{side}{part}"
        for part in ("Hip", "Knee", "Ankle", "Toe", "Collar", "Shoulder", "Elbow", "Wrist")
        for side in ("Left", "Right")
    ]
    joints = ["Hips", "Chest", "Spine", "Spine1", "Neck", "Head", *sides]
    columns, _, _ = match_names(joints)
    names = [joints[column] for column in columns]
    assert -1 not in columns
    assert names[Joint.LEFT_SHOULDER] == "LeftShoulder"
    assert names[Joint.LEFT_COLLAR] == "LeftCollar"
    assert [names[Joint.SPINE1], names[Joint.SPINE2], names[Joint.SPINE3]] == ["Spine", "Spine1", "Chest"]
    suit = [joint.name for joint in skeleton().joints]
    of_suit, _, _ = match_names(suit)
    assert suit[of_suit[Joint.LEFT_COLLAR]] == "LeftShoulder"
    assert suit[of_suit[Joint.LEFT_SHOULDER]] == "LeftArm"


def test_names_that_nobody_knows_are_told() -> None:
    columns, unmatched, _ = match_names(["Hips", "Schwanz"])
    assert unmatched == ("Schwanz",)
    assert columns.count(-1) == 21
