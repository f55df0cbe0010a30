"""Features seen from the goal: what they keep, and what a network cannot spoil."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench.geometry.skeleton import BONES, WRISTS, Joint, head_forward
from prbench_adapters.diffusion.goal_frame import (
    N_GOAL_FRAME_FEATURES,
    N_POSE_FEATURES,
    PARTS,
    TRAINED_WITH,
    GoalFrame,
    head_axes,
    planted,
    seen_condition,
    seen_size,
    sight,
)
from tests.fakes import STANDING

FPS = 20.0
FRAMES = 30


def _walk(seed: int = 0, batch: int = 2) -> torch.Tensor:
    """Motions (batch, 30, 22, 3) of rigid bones: a standing body that goes ahead, turns and bends its limbs."""
    generator = np.random.default_rng(seed)
    bones = np.array([STANDING[child] - STANDING[parent] for parent, child in BONES])
    motions = np.zeros((batch, FRAMES, 22, 3))
    for motion in motions:
        bends = generator.normal(0, 0.3, (22, 3))
        for frame, pose in enumerate(motion):
            pose[0] = STANDING[0] + np.array([0.02, 0.0, 0.05]) * frame
            for (parent, child), bone in zip(BONES, bones, strict=True):
                moved = bone + np.linalg.norm(bone) * bends[child] * np.sin(0.1 * frame)
                pose[child] = pose[parent] + moved * np.linalg.norm(bone) / np.linalg.norm(moved)
    return torch.from_numpy(motions).float()


def _raw(joints: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
    velocity = (joints[:, 1] - joints[:, 0]).flatten(1) * FPS
    return torch.cat((joints[:, 0].flatten(1), velocity, goal.flatten(1)), dim=1)


def _location(joints: torch.Tensor) -> torch.Tensor:
    return joints[:, -1, Joint.RIGHT_WRIST] + torch.tensor([0.3, 0.1, 0.4])


JOINTS = _walk()
LENGTHS = torch.tensor([FRAMES, FRAMES])
_FIRST_ANKLE = N_POSE_FEATURES - 12


@pytest.mark.parametrize("goal", ["location", "pose"])
def test_a_motion_is_decoded_from_its_features_and_conditions_have_their_size(goal):
    raw = _raw(JOINTS, _location(JOINTS) if goal == "location" else JOINTS[:, -1])
    assert seen_condition(raw).shape == (2, seen_size(goal))
    frame = GoalFrame.of(raw)
    found = frame.decode(frame.encode(JOINTS, FPS), LENGTHS, FPS)
    torch.testing.assert_close(
        found, JOINTS, rtol=0, atol=1e-2
    )  # frames are averaged, and a straight limb is bent by 5 mm


@pytest.mark.parametrize("goal", ["location", "pose"])
def test_whatever_a_network_says_bones_and_given_poses_are_kept(goal):
    frame = GoalFrame.of(_raw(JOINTS, _location(JOINTS) if goal == "location" else JOINTS[:, -1]))
    features = torch.randn((2, FRAMES, N_GOAL_FRAME_FEATURES), generator=torch.Generator().manual_seed(1))
    found = frame.decode(features, LENGTHS, FPS, parts=PARTS - {"reach"})
    parents, children = np.transpose(BONES)
    lengths = (found[:, :, children] - found[:, :, parents]).norm(dim=-1)
    assert float((lengths / frame.lengths[:, None] - 1).abs().max()) < 2e-3
    torch.testing.assert_close(found[:, 0], JOINTS[:, 0], rtol=0, atol=6e-3)
    if goal == "pose":
        torch.testing.assert_close(found[:, -1], JOINTS[:, -1], rtol=0, atol=6e-3)


def test_features_are_the_same_wherever_the_world_is_turned():
    """Only the goal's frame counts, so a body that meets its goal in the same way has the same features."""
    angle = 0.7
    turn = torch.tensor([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]).float()
    shift = torch.tensor([2.0, 0.0, -1.0])
    goal = _location(JOINTS)
    turned = JOINTS @ turn.T + shift
    here = GoalFrame.of(_raw(JOINTS, goal))
    there = GoalFrame.of(_raw(turned, goal @ turn.T + shift))
    torch.testing.assert_close(there.encode(turned, FPS), here.encode(JOINTS, FPS), rtol=0, atol=1e-5)
    assert float(here.first[:, 0].abs().max()) < 1e-6, "the goal lies ahead of the first pelvis"
    assert float(here.first[:, 2].max()) < 0.0


def test_padding_leaves_no_trace():
    frame = GoalFrame.of(_raw(JOINTS, JOINTS[:, 9]))
    features = torch.randn((2, FRAMES, N_GOAL_FRAME_FEATURES), generator=torch.Generator().manual_seed(2))
    wild = features.clone()
    wild[:, 10:] = 50.0
    short = torch.tensor([10, 10])
    found = frame.decode(features, short, FPS, parts=PARTS)[:, :10]
    torch.testing.assert_close(frame.decode(wild, short, FPS, parts=PARTS)[:, :10], found, rtol=0, atol=1e-5)


def test_the_second_frame_goes_on_with_the_initial_velocity():
    raw = _raw(JOINTS, _location(JOINTS))
    raw[:, 66:132] = 0.1  # m/s along each axis
    frame = GoalFrame.of(raw)
    found = frame.decode(frame.encode(JOINTS, FPS), LENGTHS, FPS)
    pelvis = (found[:, 1] - found[:, 0])[:, Joint.PELVIS] * FPS
    torch.testing.assert_close(pelvis, torch.full((2, 3), 0.1), rtol=0, atol=1e-3)


def test_the_nearer_wrist_is_led_to_the_goal_at_the_end_and_nothing_changes_before():
    frame = GoalFrame.of(_raw(JOINTS, _location(JOINTS)))
    features = frame.encode(JOINTS, FPS)
    before = frame.decode(features, LENGTHS, FPS)
    after = frame.decode(features, LENGTHS, FPS, parts=PARTS)
    distance = (after[:, -1][:, WRISTS] - _location(JOINTS)[:, None]).norm(dim=-1).amin(dim=1)
    assert float(distance.max()) < 0.07
    torch.testing.assert_close(after[:, : FRAMES - 11], before[:, : FRAMES - 11], rtol=0, atol=1e-6)


PARTS_LEFT_OUT = {
    # What is left out, and how far from the network's own words the motion then is not any more.
    "first": lambda joints: float((joints[:, 0] - JOINTS[:, 0]).norm(dim=-1).mean()),
    "smooth": lambda joints: float(joints.diff(n=3, dim=1).norm(dim=-1).mean()),
    "bones": lambda joints: float((_lower_arm(joints) - _lower_arm(JOINTS)).abs().max()),
}


def _lower_arm(joints: torch.Tensor) -> torch.Tensor:
    return (joints[:, :, Joint.LEFT_WRIST] - joints[:, :, Joint.LEFT_ELBOW]).norm(dim=-1)


@pytest.mark.parametrize("part", PARTS_LEFT_OUT)
def test_each_part_of_the_construction_can_be_left_to_the_network(part):
    frame = GoalFrame.of(_raw(JOINTS, _location(JOINTS)))
    noise = torch.randn((2, FRAMES, N_GOAL_FRAME_FEATURES), generator=torch.Generator().manual_seed(3))
    features = frame.encode(JOINTS, FPS) + 0.1 * noise
    constructed = PARTS_LEFT_OUT[part](frame.decode(features, LENGTHS, FPS, parts=TRAINED_WITH))
    left = PARTS_LEFT_OUT[part](frame.decode(features, LENGTHS, FPS, parts=TRAINED_WITH - {part}))
    assert left > 1.5 * constructed + 0.02


def test_averaging_leaves_slow_movement_alone_and_takes_what_alternates():
    frame = GoalFrame.of(_raw(JOINTS, _location(JOINTS)))
    still = frame.encode(JOINTS[:, :1].repeat(1, FRAMES, 1, 1), FPS)
    time = torch.arange(FRAMES) / FPS
    slow = 0.02 * torch.sin(2 * np.pi * 2.0 * time)
    for movement, kept in ((slow, 1.0), (0.02 * (-1.0) ** torch.arange(FRAMES), 0.0)):
        features = still.clone()
        features[..., 1] += movement
        height = frame.decode(features, LENGTHS, FPS)[:, 12:-2, Joint.PELVIS, 1]
        expected = (still[:, 12:-2, 1] + kept * movement[12:-2]).expand_as(height)
        torch.testing.assert_close(height, expected, rtol=0, atol=4e-4)


def test_head_axes_are_those_that_the_metric_mixes():
    forward, up = head_axes(JOINTS)
    for tilt in (0.0, 38.3):
        expected, _ = head_forward(JOINTS.numpy().reshape(-1, 22, 3), tilt)
        radians = np.deg2rad(tilt)
        mixed = np.cos(radians) * forward.numpy() + np.sin(radians) * up.numpy()
        np.testing.assert_allclose(mixed.reshape(-1, 3), expected, rtol=0, atol=1e-5)


def test_a_head_that_looks_at_the_goal_sees_it_ahead():
    joints = torch.from_numpy(STANDING).float()[None, None]
    forward, _ = head_axes(joints)
    goal = joints[0, 0, Joint.HEAD] + 2.0 * forward[0, 0]
    seen = sight(joints - goal * torch.tensor([1.0, 0.0, 1.0]), goal[1:2])
    torch.testing.assert_close(seen[0, 0, :3], torch.zeros(3), rtol=0, atol=1e-5)
    assert float(seen[0, 0, 6]) == pytest.approx(2.0)


def test_gradients_are_finite_for_straight_limbs_and_bodies_that_do_not_move():
    still = torch.from_numpy(STANDING).float().expand(1, 5, 22, 3)
    goal = torch.tensor([[0.0, 1.0, 0.0]])  # right above the pelvis: no direction
    frame = GoalFrame.of(_raw(still, goal))
    features = frame.encode(still, FPS).requires_grad_()
    joints = frame.decode(features, torch.tensor([5]), FPS)
    (gradient,) = torch.autograd.grad(joints.square().sum() + sight(joints, frame.height).sum(), features)
    assert bool(gradient.isfinite().all())


def test_a_toe_is_planted_where_it_is_low_and_still():
    joints = torch.from_numpy(STANDING).float().expand(1, 6, 22, 3).clone()
    joints[0, 3:, Joint.LEFT_FOOT, 0] += 0.1 * torch.arange(1, 4)
    joints[0, :, Joint.RIGHT_FOOT, 1] = 0.2
    assert planted(joints, FPS)[0, :, 0].tolist() == [True, True, True, False, False, False]
    assert not bool(planted(joints, FPS)[0, :, 1].any())
