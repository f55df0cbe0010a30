"""The condition vector: order, units, scaling, dropped parts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench_adapters.diffusion.configuration import (
    ConditionScaling,
    DenoiserConfiguration,
    raw_condition,
    raw_condition_of,
)
from tests.fakes import STANDING

LOCATION = DenoiserConfiguration(goal="location")
POSE = DenoiserConfiguration(goal="pose")


def _batch(condition: Condition, n: int = 2) -> ConditionBatch:
    standing = np.broadcast_to(STANDING.astype(np.float32), (n, 22, 3)).copy()
    goals = {
        Condition.GOAL_LOCATION: {"goal_location": np.full((n, 3), 2.0, dtype=np.float32)},
        Condition.GOAL_POSE: {"goal_joints": standing + np.float32(1.0)},
    }
    return ConditionBatch(
        condition=condition,
        n_frames=np.full(n, 40),
        fps=20.0,
        opaque_id=tuple("ab"[:n]),
        noise_seed=tuple(range(n)),
        text=("The person moves across and picks an object.",) * n,
        initial_joints=standing,
        previous_joints=standing - np.float32(0.05),
        **goals[condition],
    )


def test_the_vector_is_pose_then_velocity_in_metres_a_second_then_goal():
    raw = raw_condition_of(_batch(Condition.GOAL_LOCATION), LOCATION)
    assert raw is not None
    assert raw.shape == (2, 135)
    parts = LOCATION.condition_parts
    assert torch.allclose(raw[0, parts["initial_pose"]].reshape(22, 3), torch.as_tensor(STANDING, dtype=torch.float32))
    assert torch.allclose(raw[:, parts["initial_velocity"]], torch.tensor(1.0), atol=1e-5)  # 0.05 m in 1/20 s
    assert torch.allclose(raw[:, parts["goal"]], torch.tensor(2.0))


def test_a_goal_pose_takes_the_place_of_the_location():
    raw = raw_condition_of(_batch(Condition.GOAL_POSE), POSE)
    assert raw is not None
    assert raw.shape == (2, 198)
    assert torch.allclose(raw[:, POSE.condition_parts["goal"]], raw[:, POSE.condition_parts["initial_pose"]] + 1.0)


def test_a_model_without_goal_takes_no_vector():
    assert raw_condition_of(_batch(Condition.GOAL_POSE), DenoiserConfiguration()) is None


def test_the_other_kind_of_goal_is_refused():
    with pytest.raises(ValueError, match="'pose' cannot use 'goal-loc'"):
        raw_condition_of(_batch(Condition.GOAL_LOCATION), POSE)


def test_standardised_entries_have_mean_0_and_deviation_1():
    raw = torch.randn(500, 135, generator=torch.Generator().manual_seed(0)) * 3.0 + 5.0
    scaled = ConditionScaling.of(LOCATION, raw.mean(0), raw.std(0))(raw)
    assert torch.allclose(scaled.mean(0), torch.zeros(135), atol=1e-5)
    assert torch.allclose(scaled.std(0), torch.ones(135), atol=1e-5)


def test_without_scaling_velocities_are_metres_a_frame():
    literal = DenoiserConfiguration(goal="location", condition_scaling="none")
    standing = torch.as_tensor(STANDING, dtype=torch.float32)[None]
    raw = raw_condition(standing, standing - 0.05, torch.full((1, 3), 2.0), 20.0)
    scaled = ConditionScaling.of(literal, torch.full((135,), 7.0), torch.full((135,), 9.0))(raw)
    assert torch.allclose(scaled[:, literal.condition_parts["initial_velocity"]], torch.tensor(0.05), atol=1e-6)
    assert torch.equal(scaled[:, literal.condition_parts["goal"]], raw[:, literal.condition_parts["goal"]])


@pytest.mark.parametrize("name", ["initial_pose", "initial_velocity", "goal"])
def test_a_dropped_condition_is_zero_whatever_it_was_and_the_others_stay(name):
    dropping = DenoiserConfiguration(goal="location", dropped=(name,))
    raw = torch.randn(4, 135, generator=torch.Generator().manual_seed(1))
    mean, std = torch.full((135,), 0.5), torch.full((135,), 2.0)
    scaled = ConditionScaling.of(dropping, mean, std)(raw)
    whole = ConditionScaling.of(LOCATION, mean, std)(raw)
    for part, where in dropping.condition_parts.items():
        expected = torch.zeros_like(whole[:, where]) if part == name else whole[:, where]
        assert torch.equal(scaled[:, where], expected)


def test_scaling_leaves_the_given_statistics_as_they_are():
    mean, std = torch.zeros(135), torch.ones(135)
    ConditionScaling.of(DenoiserConfiguration(goal="location", condition_scaling="none"), mean, std)
    assert torch.equal(std, torch.ones(135))
