"""The small network of goal-frame features: nothing leaks from padding or batch mates, and everything is trained."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.geometry.skeleton import BONES, Joint
from prbench_adapters import pr
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.generation import SamplingSettings, generate
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.noise_optimisation import finishing
from prbench_adapters.diffusion.optimised_generation import generate_optimised
from prbench_adapters.diffusion.training import DiffusionTraining
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.task import TrainingData
from prbench_adapters.training.weights import write_weights
from tests.fakes import STANDING, fake_dataset

MODEL = {
    "architecture": "frames",
    "features": "goal-frame",
    "width": 16,
    "heads": 2,
    "layers": 2,
    "feed_forward": 24,
    "frames_per_token": 2,
    "dropout": 0.0,
    "text_encoder": "hashed-ngrams",
    "text_dimension": 64,
    "diffusion_steps": 4,
    "ray_loss_weight": 2.0,
    "foot_loss_weight": 10.0,
    "wrist_loss_weight": 1.0,
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SequenceDataset:
    folder = tmp_path_factory.mktemp("frames")
    return SequenceDataset([fake_dataset(folder / "table", n=12)], cache=folder / "cache")


def _module(data: SequenceDataset, goal: str = "location") -> DiffusionTraining:
    torch.manual_seed(0)
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    module = pr.training_task().build({**MODEL, "goal": goal}, data=given, initial=None, stage="finetune")
    for parameter in module.parameters():  # heads start at zero, which would hide everything
        torch.nn.init.normal_(parameter, 0.0, 0.1)
    return module


def _model(module: DiffusionTraining) -> MotionModel:
    return MotionModel(module.denoiser, mean=module.mean, std=module.std, scaling=module.scaling, texts=module.texts)


def _batch(goal: Condition = Condition.GOAL_LOCATION, n_frames: tuple[int, ...] = (31, 24)) -> ConditionBatch:
    count = len(n_frames)
    joints = np.repeat(STANDING[None], count, axis=0).astype(np.float32)
    place = joints[:, Joint.RIGHT_WRIST] + np.float32([0.1, 0.1, 1.0])
    wanted = {"goal_location": place} if goal is Condition.GOAL_LOCATION else {"goal_joints": joints + np.float32(0.1)}
    return ConditionBatch(
        condition=goal,
        n_frames=np.array(n_frames),
        fps=20.0,
        opaque_id=tuple(str(row) for row in range(count)),
        noise_seed=tuple(range(count)),
        text=("The person moves across and picks an object.",) * count,
        initial_joints=joints,
        previous_joints=joints - np.float32(0.01),
        **wanted,
    )


SAMPLING = SamplingSettings(guidance=1.0, sampler="ddim")


def test_neither_padding_nor_batch_mates_change_a_motion(data):
    model = _model(_module(data))
    together = generate(model, _batch(), SAMPLING).joints
    alone = generate(model, _batch(n_frames=(31,)), SAMPLING).joints
    np.testing.assert_allclose(together[0, :31], alone[0], rtol=0, atol=1e-4)


@pytest.mark.parametrize("goal", [Condition.GOAL_LOCATION, Condition.GOAL_POSE])
def test_motions_start_in_the_initial_pose_and_keep_its_bones(data, goal):
    module = _module(data, "location" if goal is Condition.GOAL_LOCATION else "pose")
    batch = _batch(goal)
    motions = generate(_model(module), batch, SAMPLING)
    assert batch.initial_joints is not None
    np.testing.assert_allclose(motions.joints[:, 0], batch.initial_joints, rtol=0, atol=6e-3)
    parents, children = np.transpose(BONES)
    lengths = np.linalg.norm(motions.joints[0, :, children] - motions.joints[0, :, parents], axis=-1)
    assert float(np.abs(lengths / lengths[:, :1] - 1).max()) < 0.01
    if batch.goal_joints is not None:
        np.testing.assert_allclose(motions.joints[0, 30], batch.goal_joints[0], rtol=0, atol=6e-3)


def test_the_end_is_known_from_the_start(data):
    """A longer motion is another one in its first frame's estimate already, because it is farther from its end."""
    module = _module(data)
    model = _model(module)
    condition = model.encode(_batch(n_frames=(31, 31)))
    noisy = torch.zeros(2, 31, 68)
    lengths = torch.tensor([31, 21])
    found = module.denoiser(noisy, torch.tensor([3, 3]), condition, lengths)
    assert float((found[0, 0] - found[1, 0]).abs().max()) > 1e-4


def test_every_weight_learns_and_the_loss_of_one_batch_falls(data):
    module = _module(data)
    batch = collate([data[index] for index in range(6)])
    optimiser = torch.optim.AdamW(module.parameters(), lr=5e-3)
    first = module(batch, 0)
    assert {"features", "joints", "ray", "feet", "wrists"} <= set(first)
    first["loss"].backward()
    assert [name for name, parameter in module.named_parameters() if parameter.grad is None] == []
    for _ in range(40):
        optimiser.zero_grad()
        loss = module(batch, 0)["loss"]
        loss.backward()
        optimiser.step()
    assert float(loss.detach()) < 0.6 * float(first["loss"].detach())


def test_conditions_know_nothing_of_the_frames_in_between(data):
    module = _module(data)
    batch = collate([data[index] for index in range(4)])
    joints = batch.joints.clone()
    joints[:, 1:-1] += 1.0
    hidden = torch.zeros(len(batch), dtype=torch.bool)
    first = module.condition(batch, hidden)
    second = module.condition(dataclasses.replace(batch, joints=joints), hidden)
    assert first.vector is not None
    assert second.vector is not None
    assert torch.equal(first.vector, second.vector)


def test_weights_are_written_and_read_back(data, tmp_path):
    module = _module(data)
    tensors, metadata = module.weights()
    write_weights(tmp_path / "w.safetensors", tensors, metadata, {})
    ours = generate(_model(module), _batch(), SAMPLING).joints
    theirs = generate(MotionModel.load(tmp_path / "w.safetensors"), _batch(), SAMPLING).joints
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)


def test_feet_can_stay_as_the_network_has_them_and_nothing_above_the_knees_changes(data):
    model = _model(_module(data))
    batch = _batch(n_frames=(31,))
    stepping = generate(model, batch, SAMPLING).joints
    gliding = generate(model, batch, dataclasses.replace(SAMPLING, feet="predicted")).joints
    moved = np.abs(stepping - gliding).max(axis=(0, 1, 3))
    legs = [joint for joint in Joint if joint.name.endswith(("KNEE", "ANKLE", "FOOT"))]
    assert moved[legs].max() > 0.01
    assert np.delete(moved, legs).max() < 1e-5


def test_more_start_noise_spreads_the_motions_of_one_sequence_and_none_leaves_one_motion(data):
    model = _model(_module(data))
    one = _batch()
    same = dataclasses.replace(one, noise_seed=(1,) * len(one))
    other = dataclasses.replace(one, noise_seed=(2,) * len(one))

    def spread(scale: float) -> float:
        settings = dataclasses.replace(SAMPLING, noise_scale=scale)
        pair = [generate(model, batch, settings).joints[0, :21] for batch in (same, other)]
        return float(np.linalg.norm(pair[0] - pair[1], axis=-1).mean())

    assert spread(0.0) == 0.0
    assert 0.0 < spread(1.0) < spread(2.0)


def test_a_wrist_can_be_led_to_the_goal_and_noise_can_be_optimised(data):
    model = _model(_module(data))
    batch = _batch(n_frames=(31,))
    assert batch.goal_location is not None

    def distance(joints: np.ndarray) -> float:
        wrists = joints[0, 30, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]]
        return float(np.linalg.norm(wrists - batch.goal_location[0], axis=-1).min())

    plain = generate(model, batch, SAMPLING).joints
    led = generate(model, batch, dataclasses.replace(SAMPLING, reach="goal")).joints
    assert distance(led) < min(distance(plain), 0.1)
    settings = dataclasses.replace(finishing(4), iterations=3)
    alone = generate_optimised(model, batch, dataclasses.replace(settings, reach="predicted")).joints
    finished = generate_optimised(model, batch, settings).joints
    assert distance(finished) < min(distance(alone), 0.1)
    assert np.abs(finished - alone)[:, :20].max() < 1e-5


@pytest.mark.parametrize(
    "changes",
    [
        {"features": "humanml3d"},
        {"architecture": "decoder"},
        {"goal": "none"},
        {"dropped": ("goal",)},
        {"uniform_skeleton": True},
    ],
)
def test_what_does_not_fit_together_is_refused(changes):
    fitting = {"architecture": "frames", "features": "goal-frame", "goal": "location"}
    DenoiserConfiguration(**fitting)
    with pytest.raises(ValueError, match=r"'features'|'uniform_skeleton'"):
        DenoiserConfiguration(**{**fitting, **changes})
