"""A trained denoiser with what belongs to it, and the condition vector."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.errors import AdapterError, InputFileError, UsageError
from prbench.representation import decode
from prbench_adapters.diffusion.configuration import (
    ConditionScaling,
    DenoiserConfiguration,
    raw_condition,
    raw_condition_of,
)
from prbench_adapters.diffusion.model import MotionModel, torch_device
from prbench_adapters.training.weights import read_weights, write_weights
from tests.adapters.diffusion import tiny
from tests.fakes import STANDING


def _goal_batch(condition: Condition) -> ConditionBatch:
    joints = np.repeat(STANDING[None], 2, axis=0).astype(np.float32)
    goal = {"goal_joints": joints + 0.5} if condition is Condition.GOAL_POSE else {"goal_location": joints[:, 21]}
    return ConditionBatch(
        condition=condition,
        n_frames=np.array([5, 7]),
        fps=20.0,
        opaque_id=("a", "b"),
        noise_seed=(1, 2),
        text=tiny.TEXTS,
        initial_joints=joints,
        previous_joints=joints - np.float32(0.01),
        **goal,
    )


def test_a_written_model_is_read_back(tmp_path):
    path = tiny.write(tmp_path / "w.safetensors", seed=3, goal="location")
    loaded, made = MotionModel.load(path), tiny.model(seed=3, goal="location")
    assert loaded.configuration == made.configuration
    for (name, ours), theirs in zip(made.denoiser.state_dict().items(), loaded.denoiser.state_dict().values()):
        assert torch.equal(ours, theirs), name
    assert torch.equal(loaded.std, made.std)
    assert loaded.digest == read_weights(path).digest


def test_a_smoothed_model_averages_neighbouring_frames():
    model = tiny.model(smoothed=True)
    normalised = torch.randn((2, 6, 263), generator=torch.Generator().manual_seed(0))
    raw = (normalised * model.std + model.mean).numpy()
    expected = raw.copy()
    expected[:, 1:-1] = (raw[:, :-2] + 2 * raw[:, 1:-1] + raw[:, 2:]) / 4
    expected[1, 3:] = raw[1, 3:]  # the last frame of the shorter one, and its padding
    condition = model.encode(tiny.text_batch([6, 4]))
    found = model.joints(normalised, condition, torch.tensor([6, 4])).numpy()
    np.testing.assert_allclose(found[0], decode(expected)[0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(found[1, :4], decode(expected)[1, :4], rtol=0, atol=1e-5)


def test_weights_are_frozen_and_dropout_is_off(tmp_path):
    model = MotionModel.load(tiny.write(tmp_path / "w.safetensors"))
    assert not model.denoiser.training
    assert not any(parameter.requires_grad for parameter in model.denoiser.parameters())


def test_joints_are_those_of_the_restored_features():
    model = tiny.model()
    normalised = torch.randn((2, 6, 263), generator=torch.Generator().manual_seed(0))
    expected = decode((normalised * model.std + model.mean).numpy())
    np.testing.assert_allclose(
        model.joints(normalised, model.encode(tiny.text_batch([6, 6])), torch.tensor([6, 6])).numpy(),
        expected,
        rtol=0,
        atol=1e-5,
    )


@pytest.mark.parametrize(("goal", "condition"), [("location", Condition.GOAL_LOCATION), ("pose", Condition.GOAL_POSE)])
def test_the_condition_vector_is_pose_velocity_and_goal(goal, condition):
    batch = _goal_batch(condition)
    model = tiny.model(goal=goal)
    size = model.configuration.condition_size
    model.scaling = ConditionScaling.of(model.configuration, torch.full((size,), 0.5), torch.full((size,), 2.0))
    encoded = model.encode(batch)
    flat = batch.initial_joints.reshape(2, 66)
    target = batch.goal_joints.reshape(2, 66) if goal == "pose" else batch.goal_location
    assert encoded.vector is not None
    expected = np.concatenate([flat, np.full((2, 66), 0.2), target], axis=1)
    np.testing.assert_allclose(encoded.vector.numpy(), (expected - 0.5) / 2.0, rtol=0, atol=1e-4)
    assert encoded.text.shape == (2, encoded.padding.shape[1], 64)


def test_other_texts_may_be_asked_for():
    model, batch = tiny.model(), tiny.text_batch([5, 5])
    swapped = model.encode(batch, texts=tuple(reversed(tiny.TEXTS)))
    assert torch.equal(swapped.text[1], model.encode(batch).text[0])


def test_missing_statistics_are_named(tmp_path):
    whole = read_weights(tiny.write(tmp_path / "w.safetensors"))
    rest = {name: tensor for name, tensor in whole.tensors.items() if name != "statistics.std"}
    write_weights(tmp_path / "less.safetensors", rest, whole.metadata, {})
    with pytest.raises(InputFileError, match=r"statistics\.std"):
        MotionModel.load(tmp_path / "less.safetensors")


def test_an_unknown_text_encoder_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no text encoder 'clip'"):
        MotionModel.load(tiny.write(tmp_path / "w.safetensors", text_encoder="clip"))


@pytest.mark.parametrize("name", ["gpu", "cuda:x", ""])
def test_a_device_that_does_not_exist_is_refused(name):
    with pytest.raises(AdapterError, match=f"--device {name}: cannot be used"):
        torch_device(name)


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
