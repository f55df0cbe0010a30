"""Losses of heads, feet and wrists, worked by hand."""

from __future__ import annotations

import pytest
import torch

from prbench.geometry.skeleton import Joint
from prbench_adapters.diffusion.training import foot_loss, ray_loss, wrist_loss
from tests.fakes import STANDING

FPS = 20.0
JOINTS = torch.from_numpy(STANDING).float().expand(1, 8, 22, 3)
VALID = torch.ones(1, 8, dtype=torch.bool)
PRIME = torch.arange(8) / FPS


def _nodding() -> torch.Tensor:
    """The neck-head bone of frame 0 level instead of upright."""
    nodded = JOINTS.clone()
    length = (JOINTS[0, 0, Joint.HEAD] - JOINTS[0, 0, Joint.NECK]).norm()
    nodded[0, 0, Joint.HEAD] = nodded[0, 0, Joint.NECK] + length * torch.tensor([0.0, 0.0, 1.0])
    return nodded


def test_the_recorded_motion_has_no_loss():
    goal = torch.tensor([[0.0, 1.0, 2.0]])
    assert float(ray_loss(JOINTS, JOINTS, goal, VALID, PRIME)) == 0.0
    assert float(foot_loss(JOINTS, JOINTS, VALID, FPS)) == 0.0
    assert float(wrist_loss(JOINTS, JOINTS, VALID, torch.tensor([8]), FPS)) == 0.0


def test_a_miss_counts_by_the_distance_of_the_goal_and_most_of_all_at_prime_time():
    near = torch.tensor([[0.0, 1.6, 1.0]])
    far = torch.tensor([[0.0, 1.6, 2.0]])
    at_prime = ray_loss(_nodding(), JOINTS, near, VALID, PRIME)
    ratio = float(ray_loss(_nodding(), JOINTS, far, VALID, PRIME) / at_prime)
    assert 3.0 < ratio < 5.0, "four times the square metres at twice the distance, about"
    assert float(ray_loss(_nodding(), JOINTS, near, VALID, PRIME + 2.0)) < float(at_prime)


def test_a_foot_that_slides_where_the_recorded_one_is_planted_has_a_loss():
    slid = JOINTS.clone()
    slid[0, 4:, Joint.LEFT_FOOT, 0] += 0.1  # one step of one foot in 7 x 2
    assert float(foot_loss(slid, JOINTS, VALID, FPS)) == pytest.approx(0.01 / 14)
    assert float(foot_loss(slid, slid, VALID, FPS)) == pytest.approx(0.0), "there nobody stands"


def test_wrists_count_at_the_end_alone():
    early = JOINTS.clone()
    early[0, 0, Joint.LEFT_WRIST] += 1.0
    late = JOINTS.clone()
    late[0, -1, Joint.LEFT_WRIST, 1] += 0.6  # of six frames and two wrists
    lengths = torch.tensor([8])
    assert float(wrist_loss(early, JOINTS, VALID, lengths, FPS)) == 0.0
    assert float(wrist_loss(late, JOINTS, VALID, lengths, FPS)) == pytest.approx(0.36 / 12)
