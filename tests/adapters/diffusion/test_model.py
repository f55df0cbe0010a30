from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.errors import AdapterError, InputFileError, UsageError
from prbench.representation import decode
from prbench_adapters.diffusion.configuration import ConditionScaling
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


def test_a_model_without_goal_takes_no_vector_from_a_goal_batch():
    assert tiny.model().encode(_goal_batch(Condition.GOAL_POSE)).vector is None


def test_a_goal_of_the_wrong_kind_is_refused():
    with pytest.raises(ValueError, match="'pose' cannot use 'goal-loc'"):
        tiny.model(goal="pose").encode(_goal_batch(Condition.GOAL_LOCATION))


def test_other_texts_may_be_asked_for():
    model, batch = tiny.model(), tiny.text_batch([5, 5])
    swapped = model.encode(batch, texts=tuple(reversed(tiny.TEXTS)))
    assert torch.equal(swapped.text[1], model.encode(batch).text[0])


def test_a_pickle_is_refused(tmp_path):
    path = tmp_path / "model.pt"
    path.write_bytes(pickle.dumps({"state_dict": [1, 2, 3]}))
    with pytest.raises(InputFileError, match="pickle"):
        MotionModel.load(path)


def test_weights_of_another_representation_are_refused(tmp_path):
    path = tiny.write(tmp_path / "w.safetensors", metadata={"representation": "joints-66"})
    with pytest.raises(InputFileError, match=r"expected 'humanml3d-263/continuous', found 'joints-66'"):
        MotionModel.load(path)


def test_weights_of_another_kind_are_refused(tmp_path):
    path = tiny.write(tmp_path / "w.safetensors", metadata={"kind": "evaluator"})
    with pytest.raises(InputFileError, match=r"expected 'denoiser', found 'evaluator'"):
        MotionModel.load(path)


def test_missing_statistics_are_named(tmp_path):
    whole = read_weights(tiny.write(tmp_path / "w.safetensors"))
    rest = {name: tensor for name, tensor in whole.tensors.items() if name != "statistics.std"}
    write_weights(tmp_path / "less.safetensors", rest, whole.metadata, {})
    with pytest.raises(InputFileError, match=r"statistics\.std"):
        MotionModel.load(tmp_path / "less.safetensors")


def test_an_unknown_text_encoder_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no text encoder 'clip'"):
        MotionModel.load(tiny.write(tmp_path / "w.safetensors", text_encoder="clip"))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_said_so(tmp_path):
    with pytest.raises(AdapterError, match=r"--device cuda: there is no usable GPU here\. Use --device cpu\."):
        MotionModel.load(tiny.write(tmp_path / "w.safetensors"), "cuda")


@pytest.mark.parametrize("name", ["gpu", "cuda:x", ""])
def test_a_device_that_does_not_exist_is_refused(name):
    with pytest.raises(AdapterError, match=f"--device {name}: cannot be used"):
        torch_device(name)
