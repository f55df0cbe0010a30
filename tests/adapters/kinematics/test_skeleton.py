"""Rotations fitted to joints and back."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from prbench.skeleton import Joint
from prbench_adapters.kinematics.rotations import rows_of
from prbench_adapters.kinematics.skeleton import fitted_rotations, forward_kinematics, rest_offsets, root_orientation
from tests.fakes import STANDING, smooth_motion

STANDING_POSE = torch.tensor(STANDING)


def _moved(pose: torch.Tensor) -> torch.Tensor:
    return forward_kinematics(fitted_rotations(pose), pose[..., Joint.PELVIS, :], rest_offsets(pose))


def test_fit_and_forward_kinematics_give_every_joint_back():
    poses = torch.tensor(smooth_motion("round trip", 40, amplitude=0.6)).double().reshape(5, 8, 22, 3)
    assert torch.allclose(_moved(poses), poses, atol=1e-9)
    assert torch.allclose(_moved(poses.float()), poses.float(), atol=5e-6)


def test_rotations_are_rotations():
    rotations = fitted_rotations(torch.tensor(smooth_motion("rotations", 20, amplitude=0.6)).double())
    assert torch.allclose(rotations @ rotations.mT, torch.eye(3, dtype=torch.float64), atol=1e-9)
    assert torch.allclose(torch.linalg.det(rotations), torch.ones(20, 22, dtype=torch.float64))


def test_turning_the_body_turns_the_root_alone():
    pose = torch.tensor(smooth_motion("turned", 1)).double()
    turn = torch.tensor(Rotation.from_euler("xyz", [0.7, -1.9, 2.6]).as_matrix())
    before, after = fitted_rotations(pose), fitted_rotations(pose @ turn.T)
    assert torch.allclose(after[:, 0], turn @ before[:, 0])
    assert torch.allclose(after[:, 1:], before[:, 1:])


def test_standing_bodies_have_the_axes_of_the_world():
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
