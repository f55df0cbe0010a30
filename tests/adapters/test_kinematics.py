"""Rotations fitted to joints and back, six numbers of a rotation, and worlds with Z up."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import Joint, z_up
from prbench_adapters.kinematics import (
    DART,
    WANDR,
    fitted_rotations,
    forward_kinematics,
    matrices_of,
    rest_offsets,
    root_orientation,
    rows_of,
    to_floor,
)
from tests.fakes import STANDING, smooth_motion

STANDING_POSE = torch.tensor(STANDING)
RANDOM = torch.tensor(Rotation.random(9, rng=np.random.default_rng(1)).as_matrix())


def _moved(pose: torch.Tensor) -> torch.Tensor:
    return forward_kinematics(fitted_rotations(pose), pose[..., Joint.PELVIS, :], rest_offsets(pose))


def test_fit_and_forward_kinematics_give_every_joint_back_by_rotations():
    poses = torch.tensor(smooth_motion("round trip", 40, amplitude=0.6)).double().reshape(5, 8, 22, 3)
    assert torch.allclose(_moved(poses), poses, atol=1e-9)
    assert torch.allclose(_moved(poses.float()), poses.float(), atol=5e-6)
    rotations = fitted_rotations(poses)
    assert torch.allclose(rotations @ rotations.mT, torch.eye(3, dtype=torch.float64), atol=1e-9)
    assert torch.allclose(torch.linalg.det(rotations), torch.ones(5, 8, 22, dtype=torch.float64))


def test_turning_the_body_turns_the_root_alone_which_stands_along_the_axes():
    pose = torch.tensor(smooth_motion("turned", 1)).double()
    turn = torch.tensor(Rotation.from_euler("xyz", [0.7, -1.9, 2.6]).as_matrix())
    before, after = fitted_rotations(pose), fitted_rotations(pose @ turn.T)
    assert torch.allclose(after[:, 0], turn @ before[:, 0])
    assert torch.allclose(after[:, 1:], before[:, 1:])
    assert torch.allclose(root_orientation(STANDING_POSE), torch.eye(3).double(), atol=1e-6)


def test_forward_kinematics_follows_the_tree_joint_by_joint():
    generator = np.random.default_rng(0)
    rotations = Rotation.random(22, rng=generator).as_matrix()
    offsets, pelvis = generator.normal(size=(22, 3)), generator.normal(size=3)
    world, joints = [rotations[0]], [pelvis]
    for joint, parent in enumerate((0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19), start=1):
        world.append(world[parent] @ rotations[joint])
        joints.append(joints[parent] + world[joint] @ offsets[joint])
    moved = forward_kinematics(torch.tensor(rotations), torch.tensor(pelvis), torch.tensor(offsets))
    assert np.allclose(moved, joints)


def test_other_bones_keep_the_directions():
    pose = torch.tensor(smooth_motion("bones", 1)).double()
    tall = forward_kinematics(fitted_rotations(pose), pose[:, 0], 2 * rest_offsets(pose))
    assert torch.allclose(tall - tall[:, :1], 2 * (pose - pose[:, :1]))


@pytest.mark.parametrize(
    ("height", "given", "move"),
    [(0.30, 0.01, -0.28), (0.015, 0.01, 0.0), (-0.05, 0.01, 0.05), (-0.03, -0.04, 0.0), (0.20, 0.10, -0.10)],
    ids=["in the air", "on the floor", "below it", "as the given pose below it", "as the given pose above it"],
)
def test_a_body_comes_back_to_the_floor_or_to_where_the_given_pose_had_it(height, given, move):
    pose = WANDR.from_y_up(STANDING_POSE).double()
    lower_toe = pose[[Joint.LEFT_FOOT, Joint.RIGHT_FOOT], 2].min()
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    found = to_floor(pose + (height - lower_toe) * up, pose + (given - lower_toe) * up)
    assert torch.allclose(found, move * up, atol=1e-6)


@pytest.mark.parametrize("way", [1e-9, 1e-4, -1e-4], ids=["exactly", "a little to the front", "a little back"])
def test_arms_straight_up_are_nothing_special(way):
    pose = STANDING_POSE.clone()
    pose[Joint.RIGHT_ELBOW] = pose[Joint.RIGHT_SHOULDER] + torch.tensor([0.0, 0.3, 0.3 * way])
    pose[Joint.RIGHT_WRIST] = pose[Joint.RIGHT_ELBOW] + torch.tensor([0.0, 0.3, 0.0])
    raised = fitted_rotations(pose)
    pose[Joint.RIGHT_ELBOW, 2] += 0.003
    change = (rows_of(fitted_rotations(pose)) - rows_of(raised)).abs().max()
    assert change < 0.03  # a hundredth of a radian, not a jump


def test_half_turns_and_vanished_bones_stay_finite():
    pose = STANDING_POSE.clone()
    pose[Joint.RIGHT_ELBOW] = pose[Joint.RIGHT_SHOULDER] + 0.3 * (
        pose[Joint.RIGHT_COLLAR] - pose[Joint.RIGHT_SHOULDER]
    )  # folds back onto the collar bone
    pose[Joint.LEFT_WRIST] = pose[Joint.LEFT_ELBOW]
    pose.requires_grad_()
    moved = _moved(pose)
    moved.square().sum().backward()
    assert torch.allclose(moved, pose, atol=1e-6)
    assert torch.isfinite(pose.grad).all()


def test_six_numbers_are_the_first_two_rows():
    quarter = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # about z
    assert rows_of(quarter).tolist() == [0, -1, 0, 1, 0, 0]
    assert torch.allclose(matrices_of(rows_of(RANDOM)), RANDOM)


def test_any_six_numbers_become_a_rotation_that_keeps_the_direction_of_the_first_row():
    made = matrices_of(torch.tensor([[0.0, 2.0, 0.0, 3.0, 5.0, 0.0]]))
    assert made.tolist() == [[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]]
    scaled = matrices_of(rows_of(RANDOM * 1.01))
    assert torch.allclose(scaled, RANDOM)


def test_worlds_turn_without_mirroring_and_back_and_bodies_face_as_published():
    points = torch.randn(7, 3, generator=torch.Generator().manual_seed(0))
    for world in (DART, WANDR):
        assert torch.allclose(torch.linalg.det(world.from_y_up(torch.eye(3)).T), torch.tensor(1.0))
        assert torch.equal(world.to_y_up(world.from_y_up(points)), points)
    front, left = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
    assert DART.from_y_up(front).tolist() == [0, 1, 0]
    assert (-DART.from_y_up(left)).tolist() == [1, 0, 0]  # its right side
    assert WANDR.from_y_up(front).tolist() == [0, -1, 0]
    assert WANDR.from_y_up(left).tolist() == [1, 0, 0]
    assert np.array_equal(WANDR.from_y_up(STANDING_POSE), z_up(STANDING))
    assert torch.equal(DART.to_y_up(DART.from_y_up(STANDING_POSE)), STANDING_POSE)
    turned = root_orientation(WANDR.from_y_up(STANDING_POSE))
    assert torch.allclose(turned[:, 2], WANDR.from_y_up(root_orientation(STANDING_POSE)[:, 2]))
