from __future__ import annotations

import pytest
import torch

from prbench.geometry.skeleton import Joint
from prbench_adapters.diffusion.noise_optimisation import (
    OptimisationSettings,
    Targets,
    jerk_norm,
    keyframes,
    largest_jerk,
    prime_and_reach,
)

LENGTH = torch.tensor([5])


def _prime_and_reach(joints, targets, **settings):
    return prime_and_reach(joints, LENGTH, targets, OptimisationSettings(**settings))


def _standing(frames=5, batch=1):
    return torch.zeros(batch, frames, 22, 3)


def _targets(**changes):
    zeros = torch.zeros(1, 22, 3)
    given = {"initial_joints": zeros, "previous_joints": zeros, **changes}
    if "goal_joints" not in given:
        given.setdefault("goal_location", torch.zeros(1, 3))
    return Targets(**given)


def test_losses_are_means_of_squared_distances():
    joints = _standing()
    joints[0, 0, Joint.HEAD] = torch.tensor([0.3, 0.0, 0.4])  # one joint of 22, half a metre away
    joints[0, -1, Joint.RIGHT_WRIST] = torch.tensor([0.0, 0.2, 0.0])
    losses = _prime_and_reach(joints, _targets(), jerk_weight=0.0)
    assert losses.initial.item() == pytest.approx(0.25 / 22)
    assert losses.goal.item() == pytest.approx(0.04)
    assert losses.minimised.item() == pytest.approx(0.25 / 22 + 0.04)
    pose = _prime_and_reach(joints, _targets(goal_joints=torch.zeros(1, 22, 3)), jerk_weight=0.0)
    assert pose.goal.item() == pytest.approx(0.04 / 22)


def test_jerk_is_the_largest_third_difference():
    joints = _standing()
    joints[0, 2, Joint.HEAD, 1] = 0.1  # differences: +3 and -3 times, so 0.3
    assert largest_jerk(joints, LENGTH).item() == pytest.approx(0.3)
    assert _prime_and_reach(joints, _targets(), jerk_weight=0.5).minimised.item() == pytest.approx(0.15)


def test_the_power_norm_of_jerks_is_above_their_maximum_and_reaches_every_jerky_place():
    joints = _standing(12)
    joints[0, 2, Joint.HEAD, 1], joints[0, 8, Joint.NECK, 1] = 0.1, 0.1
    lengths = torch.tensor([12])
    joints.requires_grad_()
    norm = jerk_norm(joints, lengths, 8.0)
    assert norm.item() == pytest.approx(0.3 * (4 + 3 / 3**8) ** 0.125)  # 3, 3 and 1 tenths; 3, 3, 1 and 1
    (gradient,) = torch.autograd.grad(norm.sum(), joints)
    assert gradient[0, 2, Joint.HEAD].norm() > 0 < gradient[0, 8, Joint.NECK].norm()
    assert torch.isfinite(gradient).all()
    assert jerk_norm(_standing(12), lengths, 8.0).item() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("frames", [1, 3])
def test_too_few_frames_have_no_jerk(frames):
    assert largest_jerk(_standing(frames), torch.tensor([frames])).item() == 0.0


def test_jerk_of_a_motion_at_rest_has_a_gradient_without_nan():
    joints = _standing().requires_grad_()
    (gradient,) = torch.autograd.grad(largest_jerk(joints, LENGTH).sum(), joints)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize(
    ("objective", "hand"), [(prime_and_reach, "right"), (prime_and_reach, "nearest"), (keyframes, "right")]
)
def test_padding_leaves_no_trace(objective, hand):
    settings = OptimisationSettings(hand=hand)
    joints = torch.randn(1, 9, 22, 3, generator=torch.Generator().manual_seed(0))
    short, padded = (objective(part, LENGTH, _targets(), settings) for part in (joints[:, :5], joints))
    for name in ("minimised", "initial", "goal"):
        torch.testing.assert_close(getattr(short, name), getattr(padded, name))
    joints.requires_grad_()
    (gradient,) = torch.autograd.grad(objective(joints, LENGTH, _targets(), settings).minimised.sum(), joints)
    assert gradient[:, 5:].abs().max() == 0.0


@pytest.mark.parametrize(("hand", "distance"), [("left", 0.1), ("right", 0.5), ("nearest", 0.1)])
def test_the_hand_decides_which_wrist_is_measured(hand, distance):
    joints = _standing()
    joints[0, -1, Joint.LEFT_WRIST, 0], joints[0, -1, Joint.RIGHT_WRIST, 0] = 0.1, 0.5
    losses = _prime_and_reach(joints, _targets(), hand=hand)
    assert losses.goal.item() == pytest.approx(distance**2)


def test_the_soft_minimum_pulls_the_nearer_wrist_only_once_it_is_clearly_nearer():
    joints = _standing()
    joints[0, -1, Joint.LEFT_WRIST, 0], joints[0, -1, Joint.RIGHT_WRIST, 0] = 0.2, 0.8
    joints.requires_grad_()
    losses = _prime_and_reach(joints, _targets(), jerk_weight=0.0, hand="nearest")
    assert losses.minimised.item() <= losses.goal.item()
    (gradient,) = torch.autograd.grad(losses.minimised.sum(), joints)
    assert gradient[0, -1, Joint.LEFT_WRIST, 0].item() == pytest.approx(0.4, rel=1e-3)
    assert gradient[0, -1, Joint.RIGHT_WRIST, 0].abs().item() < 1e-9


def test_the_initial_velocity_counts_when_asked_for():
    targets = _targets(previous_joints=torch.full((1, 22, 3), -0.1))  # 0.1 m a frame along each axis
    without = _prime_and_reach(_standing(), targets, jerk_weight=0.0)
    weighted = _prime_and_reach(_standing(), targets, jerk_weight=0.0, initial_velocity_weight=2.0)
    assert (weighted.minimised - without.minimised).item() == pytest.approx(2.0 * 0.03)


def test_keyframes_are_mean_absolute_errors_over_all_coordinates_asked_for():
    joints = _standing()
    joints[0, 0, 0, 0], joints[0, -1, Joint.RIGHT_WRIST, 1] = 0.69, -0.69
    settings = OptimisationSettings()
    assert keyframes(joints, LENGTH, _targets(), settings).minimised.item() == pytest.approx(2 * 0.69 / 69)
    pose = keyframes(joints, LENGTH, _targets(goal_joints=torch.zeros(1, 22, 3)), settings)
    assert pose.minimised.item() == pytest.approx(2 * 0.69 / 132)


def test_exactly_one_goal_must_be_given():
    with pytest.raises(ValueError, match="either a goal pose or a goal location"):
        _targets(goal_joints=torch.zeros(1, 22, 3), goal_location=torch.zeros(1, 3))
