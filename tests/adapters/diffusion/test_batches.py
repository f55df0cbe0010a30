from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.geometry import skeleton
from prbench.geometry.skeleton import BONES, Joint
from prbench.randomness import sequence_generator
from prbench.representation import REST_OFFSETS
from prbench_adapters.diffusion.generation import (
    ModelBodies,
    SequenceNoise,
    bone_lengths,
    parts_of_similar_length,
    start_noise,
    with_bone_lengths,
)
from tests.adapters.diffusion import tiny
from tests.fakes import STANDING, smooth_motion


def _lists(n_frames: list[int], largest: int) -> list[list[int]]:
    return [part.tolist() for part in parts_of_similar_length(np.array(n_frames), largest)]


def test_a_part_ends_where_the_shortest_would_be_padded_by_more_than_a_quarter():
    assert _lists([50, 40, 51, 100], 8) == [[1, 0], [2], [3]]


def test_a_part_ends_when_it_is_full():
    assert _lists([10, 10, 10, 10, 10], 2) == [[0, 1], [2, 3], [4]]


def test_every_row_is_in_one_part():
    n_frames = np.random.default_rng(0).integers(20, 240, 50)
    parts = parts_of_similar_length(n_frames, 7)
    assert sorted(np.concatenate(parts).tolist()) == list(range(50))
    assert all(n_frames[part].max() <= 1.25 * n_frames[part].min() for part in parts)


def test_the_noise_of_a_sequence_depends_on_its_seed_alone():
    alone = start_noise([7], np.array([5]))[0]
    first, second = start_noise([9, 7], np.array([8, 5])), start_noise([7, 9], np.array([5, 8]))
    assert torch.equal(first[1, :5], alone)
    assert torch.equal(second[0, :5], alone)
    assert torch.equal(second[1], first[0])
    assert not torch.equal(first[0, :5], alone)


def test_the_noise_is_that_of_the_sequences_generator_and_padding_is_zero():
    noise = SequenceNoise([3, 4], np.array([2, 4]))
    first, second = noise.draw(), noise.draw()
    generator = sequence_generator(3)
    for drawn in (first, second):
        expected = generator.standard_normal((2, 263), dtype=np.float32)
        assert np.array_equal(drawn[0, :2].numpy(), expected)
        assert not drawn[0, 2:].any()


def test_a_longer_sequence_of_the_same_seed_begins_alike():
    assert torch.equal(start_noise([5], np.array([9]))[0, :4], start_noise([5], np.array([4]))[0])


def test_the_noise_is_standard_normal():
    noise = start_noise([1, 2], np.array([200, 200]))
    assert abs(float(noise.mean())) < 0.01
    assert abs(float(noise.std()) - 1) < 0.01
    assert abs(float((noise[0] * noise[1]).mean())) < 0.01


SIZES = np.array([0.8, 1.1], dtype=np.float32)


@pytest.fixture
def batch() -> ConditionBatch:
    """Two bodies of different sizes in the same pose, each with a goal at its own scale."""
    joints = (STANDING[None] * SIZES[:, None, None]).astype(np.float32)
    goals = {"goal_location": (np.array([[0.5, 1.0, 2.0]]) * SIZES[:, None]).astype(np.float32)}
    common = {"n_frames": np.array([5, 5]), "fps": 20.0, "opaque_id": ("a", "b"), "noise_seed": (1, 2)}
    return ConditionBatch(
        condition=Condition.GOAL_LOCATION,
        text=tiny.TEXTS,
        initial_joints=joints,
        previous_joints=joints,
        **common,
        **goals,
    )


def test_a_model_of_bodies_with_their_own_bones_changes_nothing(batch):
    bodies = ModelBodies.of(batch, tiny.configuration(goal="location"))
    assert bodies.batch is batch
    joints = np.zeros((2, 5, 22, 3), dtype=np.float32)
    assert bodies.own(joints) is joints


def test_a_model_of_one_skeleton_is_given_that_skeleton_and_scaled_goals(batch):
    bodies = ModelBodies.of(batch, tiny.configuration(goal="location", uniform_skeleton=True))
    wanted = np.linalg.norm(REST_OFFSETS[1:], axis=1)
    np.testing.assert_allclose(skeleton.bone_lengths(bodies.batch.initial_joints[0]), wanted, atol=1e-5)
    np.testing.assert_allclose(skeleton.bone_lengths(bodies.batch.previous_joints[1]), wanted, atol=1e-5)
    goals = bodies.batch.goal_location  # the bodies differ by their size alone, so on one skeleton the goals agree
    np.testing.assert_allclose(goals[0], goals[1], atol=1e-5)


def test_motions_come_back_at_the_scale_of_the_bodies(batch):
    bodies = ModelBodies.of(batch, tiny.configuration(goal="location", uniform_skeleton=True))
    joints = np.broadcast_to(bodies.batch.goal_location[:, None, None], (2, 5, 22, 3)).astype(np.float32)
    back = bodies.own(joints)
    np.testing.assert_allclose(back[:, 3, 7], batch.goal_location, atol=1e-5)


def test_without_an_initial_pose_the_size_is_the_models(batch):
    text_only = tiny.text_batch([5, 5])
    bodies = ModelBodies.of(text_only, tiny.configuration(uniform_skeleton=True))
    assert bodies.batch is text_only
    assert bodies.skeleton is None


def test_goal_poses_change_skeleton_too(batch):
    pose = dataclasses.replace(
        batch, condition=Condition.GOAL_POSE, goal_location=None, goal_joints=batch.initial_joints
    )
    bodies = ModelBodies.of(pose, tiny.configuration(goal="pose", uniform_skeleton=True))
    np.testing.assert_allclose(bodies.batch.goal_joints, bodies.batch.initial_joints, atol=1e-6)


WOBBLING = torch.as_tensor(np.stack([smooth_motion(name, 20) for name in "ab"]))
LENGTHS = bone_lengths(torch.as_tensor(np.stack([STANDING, STANDING * 1.1]), dtype=torch.float32))


def test_the_lengths_are_those_asked_for_in_every_frame():
    found = bone_lengths(with_bone_lengths(WOBBLING, LENGTHS))
    assert torch.allclose(found, LENGTHS[:, None].expand_as(found), atol=1e-6)


def test_directions_the_pelvis_over_the_floor_and_the_lowest_height_stay():
    relaid = with_bone_lengths(WOBBLING, LENGTHS)
    assert torch.equal(relaid[:, :, Joint.PELVIS, ::2], WOBBLING[:, :, Joint.PELVIS, ::2])
    torch.testing.assert_close(relaid[..., 1].amin(dim=-1), WOBBLING[..., 1].amin(dim=-1))
    parents, children = np.transpose(BONES)
    before, after = (motion[:, :, children] - motion[:, :, parents] for motion in (WOBBLING, relaid))
    cosine = torch.nn.functional.cosine_similarity(before, after, dim=-1)
    assert torch.allclose(cosine, torch.ones_like(cosine), atol=1e-5)


def test_a_motion_that_has_these_lengths_already_stays_as_it_is():
    relaid = with_bone_lengths(WOBBLING, LENGTHS)
    assert torch.allclose(with_bone_lengths(relaid, LENGTHS), relaid, atol=1e-6)


def test_gradients_reach_every_joint_and_are_finite_for_a_vanished_bone():
    joints = WOBBLING.clone()
    joints[0, 3, Joint.HEAD] = joints[0, 3, Joint.NECK]
    joints.requires_grad_()
    with_bone_lengths(joints, LENGTHS)[:, :, Joint.RIGHT_WRIST].square().sum().backward()
    assert joints.grad is not None
    assert torch.isfinite(joints.grad).all()
    moving = joints.grad.abs().amax(dim=(0, 1, 3)) > 0
    assert moving[Joint.RIGHT_ELBOW]
    assert moving[Joint.PELVIS]
    assert not moving[Joint.LEFT_WRIST]
