"""A trained denoiser with what belongs to it, and the condition vector."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.errors import AdapterError, InputFileError, UsageError
from prbench.representation import decode
from prbench_adapters.diffusion.configuration import (
    ConditionScaling,
    DenoiserConfiguration,
    raw_condition,
)
from prbench_adapters.diffusion.model import SMOOTHINGS, MotionModel, torch_device
from prbench_adapters.training.weights import read_weights, write_weights
from tests.adapters.diffusion import tiny
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import STANDING


def test_a_written_model_is_read_back(tmp_path):
    path = tiny.write(tmp_path / "w.safetensors", seed=3, goal="location")
    loaded, made = MotionModel.load(path), tiny.model(seed=3, goal="location")
    assert loaded.configuration == made.configuration
    for (name, ours), theirs in zip(made.denoiser.state_dict().items(), loaded.denoiser.state_dict().values()):
        assert torch.equal(ours, theirs), name
    assert torch.equal(loaded.std, made.std)
    assert loaded.digest == read_weights(path).digest
    assert not loaded.denoiser.training
    assert not any(parameter.requires_grad for parameter in loaded.denoiser.parameters())


@pytest.mark.parametrize("smoothed", [False, True])
def test_joints_are_those_of_restored_features_and_a_smoothed_model_averages_neighbours(smoothed):
    model = tiny.model(smoothed=smoothed)
    normalised = torch.randn((2, 6, 263), generator=torch.Generator().manual_seed(0))
    raw = (normalised * model.std + model.mean).numpy()
    expected = raw.copy()
    for _ in range(SMOOTHINGS if smoothed else 0):
        before = expected.copy()
        expected[:, 1:-1] = (before[:, :-2] + 2 * before[:, 1:-1] + before[:, 2:]) / 4
        expected[1, 3:] = raw[1, 3:]  # the last frame of the shorter one, and its padding
    found = model.joints(normalised, model.encode(tiny.text_batch([6, 4])), torch.tensor([6, 4])).numpy()
    np.testing.assert_allclose(found[0], decode(expected)[0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(found[1, :4], decode(expected)[1, :4], rtol=0, atol=1e-5)


@pytest.mark.parametrize(("goal", "condition"), [("location", Condition.GOAL_LOCATION), ("pose", Condition.GOAL_POSE)])
def test_the_condition_vector_is_pose_velocity_in_metres_a_second_and_goal(goal, condition):
    batch, model = conditions(condition, 2), tiny.model(goal=goal)
    size = model.configuration.condition_size
    assert size == {"location": 135, "pose": 198}[goal]
    assert sum(part.stop - part.start for part in model.configuration.condition_parts.values()) == size
    model.scaling = ConditionScaling.of(model.configuration, torch.full((size,), 0.5), torch.full((size,), 2.0))
    encoded = model.encode(batch)
    target = batch.goal_joints.reshape(2, 66) if goal == "pose" else batch.goal_location
    expected = np.concatenate([batch.initial_joints.reshape(2, 66), np.full((2, 66), 0.2), target], axis=1)
    assert encoded.vector is not None
    np.testing.assert_allclose(encoded.vector.numpy(), (expected - 0.5) / 2.0, rtol=0, atol=1e-4)
    assert encoded.text.shape == (2, encoded.padding.shape[1], 64)
    assert tiny.model().encode(batch).vector is None
    other = tiny.model(goal="location" if goal == "pose" else "pose")
    with pytest.raises(ValueError, match=f"'{other.configuration.goal}' cannot use '{condition.value}'"):
        other.encode(batch)


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
