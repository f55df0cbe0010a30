"""The small network of goal-frame features: nothing leaks from padding or batch mates, and everything is trained."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.geometry.skeleton import BONES, Joint
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.generation import SamplingSettings, generate
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.noise_optimisation import finishing
from prbench_adapters.diffusion.optimised_generation import generate_optimised
from prbench_adapters.diffusion.training import DiffusionTraining
from tests.adapters.diffusion.goal_batches import conditions
from tests.adapters.trained import build, saved


def _module(goal: str = "location") -> DiffusionTraining:
    module = build("pr-frames", goal=goal, **({} if goal == "location" else {"ray_loss_weight": 0.0}))
    torch.manual_seed(0)
    for parameter in module.parameters():  # heads start at zero, which would hide everything
        torch.nn.init.normal_(parameter, 0.0, 0.1)
    return module


def _model(module: DiffusionTraining) -> MotionModel:
    return MotionModel(module.denoiser, mean=module.mean, std=module.std, scaling=module.scaling, texts=module.texts)


def _batch(goal: Condition = Condition.GOAL_LOCATION, n_frames: tuple[int, ...] = (31, 24)) -> ConditionBatch:
    batch = conditions(goal, len(n_frames), frames=n_frames)
    assert batch.initial_joints is not None
    if goal is Condition.GOAL_POSE:
        return dataclasses.replace(batch, goal_joints=batch.initial_joints + np.float32(0.1))
    place = batch.initial_joints[:, Joint.RIGHT_WRIST] + np.float32([0.1, 0.1, 1.0])
    return dataclasses.replace(batch, goal_location=place)


SAMPLING = SamplingSettings(guidance=1.0, sampler="ddim")


def test_neither_padding_nor_batch_mates_change_a_motion():
    model = _model(_module())
    together = generate(model, _batch(), SAMPLING).joints
    alone = generate(model, _batch(n_frames=(31,)), SAMPLING).joints
    np.testing.assert_allclose(together[0, :31], alone[0], rtol=0, atol=1e-4)


@pytest.mark.parametrize("goal", [Condition.GOAL_LOCATION, Condition.GOAL_POSE])
def test_motions_start_in_the_initial_pose_and_keep_its_bones(goal):
    module = _module("location" if goal is Condition.GOAL_LOCATION else "pose")
    batch = _batch(goal)
    motions = generate(_model(module), batch, SAMPLING)
    assert batch.initial_joints is not None
    np.testing.assert_allclose(motions.joints[:, 0], batch.initial_joints, rtol=0, atol=6e-3)
    parents, children = np.transpose(BONES)
    lengths = np.linalg.norm(motions.joints[0, :, children] - motions.joints[0, :, parents], axis=-1)
    assert float(np.abs(lengths / lengths[:, :1] - 1).max()) < 0.01
    if batch.goal_joints is not None:
        np.testing.assert_allclose(motions.joints[0, 30], batch.goal_joints[0], rtol=0, atol=6e-3)


def test_the_end_is_known_from_the_start():
    """A longer motion is another one in its first frame's estimate already, because it is farther from its end."""
    module = _module()
    model = _model(module)
    condition = model.encode(_batch(n_frames=(31, 31)))
    noisy = torch.zeros(2, 31, 68)
    lengths = torch.tensor([31, 21])
    found = module.denoiser(noisy, torch.tensor([3, 3]), condition, lengths)
    assert float((found[0, 0] - found[1, 0]).abs().max()) > 1e-4


def test_weights_are_written_and_read_back(tmp_path):
    module = _module()
    path = saved(module, tmp_path / "w.safetensors")
    ours = generate(_model(module), _batch(), SAMPLING).joints
    theirs = generate(MotionModel.load(path), _batch(), SAMPLING).joints
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)


def test_feet_can_stay_as_the_network_has_them_and_nothing_above_the_knees_changes():
    model = _model(_module())
    batch = _batch(n_frames=(31,))
    stepping = generate(model, batch, SAMPLING).joints
    gliding = generate(model, batch, dataclasses.replace(SAMPLING, feet="predicted")).joints
    moved = np.abs(stepping - gliding).max(axis=(0, 1, 3))
    legs = [joint for joint in Joint if joint.name.endswith(("KNEE", "ANKLE", "FOOT"))]
    assert moved[legs].max() > 0.01
    assert np.delete(moved, legs).max() < 1e-5


def test_more_start_noise_spreads_the_motions_of_one_sequence_and_none_leaves_one_motion():
    model = _model(_module())
    one = _batch()
    same = dataclasses.replace(one, noise_seed=(1,) * len(one))
    other = dataclasses.replace(one, noise_seed=(2,) * len(one))

    def spread(scale: float) -> float:
        settings = dataclasses.replace(SAMPLING, noise_scale=scale)
        pair = [generate(model, batch, settings).joints[0, :21] for batch in (same, other)]
        return float(np.linalg.norm(pair[0] - pair[1], axis=-1).mean())

    assert spread(0.0) == 0.0
    assert 0.0 < spread(1.0) < spread(2.0)


def test_a_wrist_can_be_led_to_the_goal_and_noise_can_be_optimised():
    model = _model(_module())
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
