from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.contract import Condition, ConditionBatch
from prbench.representation import REST_OFFSETS
from prbench.skeleton import bone_lengths
from prbench_adapters.diffusion.skeletons import ModelBodies
from tests.adapters.diffusion import tiny
from tests.fakes import STANDING

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
    np.testing.assert_allclose(bone_lengths(bodies.batch.initial_joints[0]), wanted, atol=1e-5)
    np.testing.assert_allclose(bone_lengths(bodies.batch.previous_joints[1]), wanted, atol=1e-5)
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
