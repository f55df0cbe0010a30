"""Goals, imputation and both sampling, with networks of random weights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.contract import ConditionBatch
from prbench.geometry.skeleton import Joint
from prbench_adapters.diffusion.generation import SequenceNoise
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.gmd import sampling
from prbench_adapters.gmd.adapter import generate
from prbench_adapters.gmd.sampling import Ends, GMDSettings, RootGoal, clean_of_noise, guided_mean, imputed_root
from tests.adapters.gmd import tiny


def _ends() -> Ends:
    first, last = torch.zeros(2, 22, 3), torch.zeros(2, 22, 3)
    last[0, Joint.PELVIS] = torch.tensor([1.0, 0.9, 2.0])
    last[1, Joint.PELVIS] = torch.tensor([0.0, 0.8, -3.0])
    return Ends(first, last, torch.tensor([5, 3]))


def test_keyframes_are_the_first_and_the_last_frame_of_each_motion():
    goal = _ends().root_keyframes()
    assert goal.wanted.tolist() == [[True, False, False, False, True], [True, False, True, False, False]]
    assert goal.xz[0, [0, 4]].tolist() == [[0, 0], [1, 2]]
    assert goal.xz[1, [0, 2]].tolist() == [[0, 0], [0, -3]]


def test_the_line_is_straight_and_of_constant_speed():
    goal = _ends().root_keyframes().line()
    assert torch.allclose(goal.xz[0], torch.linspace(0, 1, 5)[:, None] * torch.tensor([1.0, 2.0]))
    assert torch.allclose(goal.xz[1, :3, 1], torch.tensor([0.0, -1.5, -3.0]))
    assert goal.wanted.tolist() == [[True] * 5, [True, True, True, False, False]]


def test_the_loss_is_the_mean_error_of_each_row_over_its_keyframes():
    goal = _ends().root_keyframes()
    root = goal.xz + torch.tensor([0.3, -0.1])
    assert torch.allclose(goal.loss(root), torch.tensor([0.2, 0.2]))
    root[1, 1] = 99.0  # no keyframe
    assert torch.allclose(goal.loss(root), torch.tensor([0.2, 0.2]))


def test_only_the_ground_position_of_the_root_is_imputed():
    space, goal = tiny.space(), _ends().root_keyframes()
    values, where = imputed_root(goal, space, 263)
    assert where[0, 4].nonzero().flatten().tolist() == [1, 2]
    assert int(where.sum()) == 2 * 4
    restored = space.restored(values)
    assert torch.allclose(restored[where], torch.tensor([0.0, 0, 1, 2, 0, 0, 0, -3]), atol=1e-6)


def test_the_gradient_goes_through_the_network():
    """A network that hands frame 0 what frame 4 holds: the goal of one moves the other, by β̃ · scale · gradient."""
    chain = CosineSchedule(10)
    goal = RootGoal(torch.ones(1, 5, 2), torch.tensor([[True, False, False, False, False]]))
    state = torch.zeros(1, 5, 4)
    mean = guided_mean(
        lambda noisy, _: 3.0 * noisy.flip(1), chain, 6, state, lambda clean: goal.loss(clean[..., 1:3]), 100.0
    )
    expected = torch.zeros(1, 5, 4)
    expected[0, 4, 1:3] = 100.0 * float(chain.posterior_variance[6]) * 3.0 / 2
    assert torch.allclose(mean, expected, rtol=1e-6)


def test_estimates_of_the_trajectory_are_cut_at_six_deviations():
    chain, noise = CosineSchedule(10), torch.zeros(1, 2, 4)
    state = torch.tensor([5.0, 8.0])[None, :, None].expand(1, 2, 4) * float(chain.alphas_cumprod[3]) ** 0.5
    assert torch.allclose(clean_of_noise(chain, 3, state, noise)[0, :, 0], torch.tensor([5.0, 6.0]))


def test_without_a_goal_no_gradient_is_taken():
    def network(noisy: torch.Tensor, _: int) -> torch.Tensor:
        assert not torch.is_grad_enabled()
        return noisy

    with torch.enable_grad():
        guided_mean(network, CosineSchedule(10), 6, torch.zeros(1, 5, 4), None, 100.0)


@pytest.mark.parametrize(("steps", "limits"), [(1000, (20, 100, 1)), (100, (2, 10, 1)), (50, (1, 5, 1))])
def test_limits_scale_with_the_schedule(steps, limits):
    schedule = CosineSchedule(steps)
    assert tuple(sampling._step(schedule, of_thousand) for of_thousand in (20, 100, 1)) == limits
    assert sampling._step(schedule, 0) == 0


def _root(joints: np.ndarray) -> np.ndarray:
    return joints[:, Joint.PELVIS, ::2]


def _errors(batch: ConditionBatch, joints: np.ndarray) -> np.ndarray:
    """Distance of the root to its first and its last keyframe, metres."""
    assert batch.goal_joints is not None
    assert batch.initial_joints is not None
    last = joints[np.arange(len(batch)), batch.n_frames - 1]
    ends = ((joints[:, 0], batch.initial_joints), (last, batch.goal_joints))
    return np.array([np.linalg.norm(_root(found) - _root(wanted), axis=1) for found, wanted in ends])


@pytest.fixture(scope="module")
def model():
    return tiny.model()


@pytest.mark.parametrize(("keyframes", "seed"), [("root", 1), ("pose", 2)])
def test_the_root_is_at_its_keyframes_whatever_the_networks_say(keyframes, seed):
    batch = tiny.batch()
    motions = generate(tiny.model(seed=seed), batch, GMDSettings(keyframes=keyframes, steps=5))
    assert _errors(batch, motions.joints).max() < 1e-3


def test_another_goal_moves_the_end_there(model):
    batch = tiny.batch()
    assert batch.goal_joints is not None
    shuffled = dataclasses.replace(batch, goal_joints=batch.goal_joints[[1, 2, 0]])
    motions = generate(model, shuffled, GMDSettings(steps=5))
    assert _errors(shuffled, motions.joints)[1].max() < 0.1
    assert _errors(batch, motions.joints)[1].min() > 0.2


def test_whole_poses_are_met_when_they_are_imputed(model):
    batch = tiny.batch()
    joints = generate(model, batch, GMDSettings(keyframes="pose", steps=5)).joints
    last = joints[np.arange(3), batch.n_frames - 1]
    assert np.allclose(joints[:, 0], batch.initial_joints, atol=1e-3)
    assert np.allclose(last, batch.goal_joints, atol=1e-3)
    rooted = generate(model, batch, GMDSettings(steps=5)).joints
    assert not np.allclose(rooted[:, 0], batch.initial_joints, atol=0.1)


def test_the_body_follows_the_whole_trajectory(model, monkeypatch):
    followed = []
    trajectory_stage = sampling.sample_trajectory

    def watched(*arguments, **keywords):
        followed.append(trajectory_stage(*arguments, **keywords))
        return followed[-1]

    monkeypatch.setattr("prbench_adapters.gmd.adapter.sample_trajectory", watched)
    joints = generate(model, tiny.batch((24,)), GMDSettings(steps=5)).joints
    assert np.allclose(_root(joints[0]), followed[0][0, :, 1:3].numpy(), atol=1e-4)


def test_the_goal_scale_matters_and_zero_takes_no_gradient(model, monkeypatch):
    batch = tiny.batch((12,))
    guided = generate(model, batch, GMDSettings(steps=5)).joints
    monkeypatch.setattr(torch.autograd, "grad", None)
    free = generate(model, batch, GMDSettings(steps=5, goal_scale=0.0)).joints
    assert not np.allclose(guided, free, atol=1e-3)


def test_motions_of_one_and_of_two_frames_are_generated(model):
    joints = generate(model, tiny.batch((2, 1)), GMDSettings(steps=5)).joints
    assert np.isfinite(joints[0, :2]).all()
    assert np.isfinite(joints[1, :1]).all()


def test_each_step_imputes_and_guides_as_its_noise_asks(monkeypatch):
    """100 steps: the line while t ≥ 10, then the keyframes; gradients while t ≥ 2; a body of five frames follows."""
    imputed: list[list[tuple[int, int]]] = [[], []]
    guided: list[int] = []

    def noising(chain, i, state, overwritten, noise):
        imputed[0].append((i, int(overwritten[1][0].any(dim=1).sum())))
        return state

    def in_mean(space, chain, i, state, mean, overwritten):
        imputed[1].append((i, int(overwritten[1][0].any(dim=1).sum())))
        return mean

    def mean_of(estimate, chain, i, state, loss, scale):
        guided.extend([i] if loss is not None else [])
        return state

    monkeypatch.setattr(sampling, "imputed_by_noising", noising)
    monkeypatch.setattr(sampling, "imputed_in_mean", in_mean)
    monkeypatch.setattr(sampling, "guided_mean", mean_of)
    model, ends, settings = tiny.model(diffusion_steps=100), _ends(), GMDSettings()
    noise = SequenceNoise([1, 2], ends.n_frames.numpy())
    text, window = torch.zeros(2, 64), model.configuration.window(5)
    network = sampling.GuidedNetwork(model.networks.motion, text, ends.n_frames, window=window, scale=1.0)
    trajectory = sampling.sample_trajectory(
        network, model.schedule, model.space, ends.root_keyframes(), noise, settings
    )
    sampling.sample_motion(network, model.schedule, model.space, trajectory, ends, noise, settings)

    line = [(t, 5) for t in range(99, 9, -1)]
    assert imputed[0] == line + [(t, 2) for t in range(9, -1, -1)]
    assert imputed[1] == [(t, 5) for t in range(99, -1, -1)]
    assert guided == 2 * list(range(99, 1, -1))
