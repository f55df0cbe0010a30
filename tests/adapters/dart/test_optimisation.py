"""What the optimiser does with the noise of primitives, on maps whose answer is known and on tiny networks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.geometry.skeleton import Joint
from prbench_adapters.dart.adapter import generate
from prbench_adapters.dart.model import DartSettings
from prbench_adapters.dart.rollout import goal_loss, optimise
from prbench_adapters.diffusion.noise_optimisation import Targets
from tests.adapters.dart import tiny
from tests.adapters.diffusion.goal_batches import conditions

POSE = torch.zeros(1, 22, 3)


def _targets(goal: torch.Tensor | None = None, location: torch.Tensor | None = None, n: int = 1) -> Targets:
    pose = POSE.expand(n, 22, 3)
    return Targets(initial_joints=pose, previous_joints=pose, goal_joints=goal, goal_location=location)


def test_the_loss_of_a_goal_location_by_hand():
    """Huber of 0.6, 0 and 3 m with δ = 1: 0.18, 0 and 2.5; their mean."""
    joints = torch.zeros(1, 4, 22, 3)
    joints[0, 2, Joint.RIGHT_WRIST] = torch.tensor([0.6, 0.0, 3.0])
    joints[0, 3] = 100.0  # padding
    loss = goal_loss(joints, torch.tensor([3]), _targets(location=torch.zeros(1, 3)), DartSettings())
    assert loss.item() == pytest.approx((0.18 + 2.5) / 3)


def test_the_loss_of_a_goal_pose_is_averaged_over_all_its_coordinates():
    joints = torch.zeros(1, 2, 22, 3)
    joints[0, 1, 5, 0] = 0.6
    loss = goal_loss(joints, torch.tensor([2]), _targets(goal=POSE), DartSettings())
    assert loss.item() == pytest.approx(0.18 / 66)


def test_the_other_wrist_counts_where_it_is_asked_for():
    joints = torch.zeros(1, 1, 22, 3)
    joints[0, 0, Joint.RIGHT_WRIST, 0] = 0.6
    given = (joints, torch.tensor([1]), _targets(location=torch.zeros(1, 3)))
    assert goal_loss(*given, DartSettings(hand="left")).item() == 0
    assert goal_loss(*given, DartSettings(hand="nearest")).item() == 0
    assert goal_loss(*given, DartSettings()).item() > 0


def test_adam_walks_at_a_falling_rate():
    """A constant gradient moves Adam by its learning rate in each step: 0.05 · (1 + … + 1/100)."""

    def motion(noise):
        return noise.sum(dim=(0, 2, 3))[:, None, None, None].expand(-1, 1, 22, 3)

    far = _targets(goal=POSE + 100.0)
    noise, _ = optimise(motion, torch.zeros(2, 1, 1, 3), far, torch.tensor([1]), DartSettings())
    torch.testing.assert_close(noise, torch.full((2, 1, 1, 3), 0.05 * sum(i / 100 for i in range(1, 101))))


@pytest.fixture(scope="module")
def model():
    return tiny.model(seed=1, diffusion_steps=2)


@pytest.mark.parametrize("condition", [Condition.GOAL_POSE, Condition.GOAL_LOCATION])
def test_the_last_frame_comes_to_a_goal_that_the_model_can_reach(model, condition):
    """The goals are the last frames of free motions, so a noise exists that meets them."""
    given = conditions(condition, 2, frames=(12,))
    free = generate(model, replace(given, noise_seed=(7, 8)), DartSettings(optimised=False)).joints
    last = free[np.arange(2), given.n_frames - 1]
    if condition is Condition.GOAL_POSE:
        given, asked = replace(given, goal_joints=last), np.arange(22)
    else:
        given, asked = replace(given, goal_location=last[:, Joint.RIGHT_WRIST]), np.array([Joint.RIGHT_WRIST])

    def error(iterations: int) -> np.ndarray:
        joints = generate(model, given, DartSettings(iterations=iterations)).joints
        reached = joints[np.arange(2), given.n_frames - 1]
        return np.linalg.norm(reached[:, asked] - last[:, asked], axis=-1).mean(axis=1)

    before, after = error(1), error(100)
    assert (after < 0.25 * before).all(), (before, after)
    assert (after < 0.02).all(), (before, after)
