"""Objectives, solver and settings of noise optimisation: by hand, by laws, beside the published program."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from prbench.geometry.skeleton import Joint
from prbench.randomness import named_generator
from prbench.representation import tensors
from prbench_adapters.diffusion.configuration import EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.noise_optimisation import (
    KEYFRAME_OPTIONS,
    PRIME_AND_REACH_OPTIONS,
    OptimisationSettings,
    Targets,
    decorrelation,
    dno_paper,
    fast,
    jerk_norm,
    keyframes,
    largest_jerk,
    learning_rate_factor,
    optimisation_settings,
    optimise,
    padded_decorrelation,
    paper,
    prime_and_reach,
    smoothed_over_time,
)
from prbench_adapters.diffusion.optimised_generation import optimise_noise
from tests.adapters.diffusion import golden
from tests.adapters.diffusion.tiny import LinearDecoder, noise


def test_the_paper_mode_is_the_papers():
    settings = paper(50)
    assert (settings.ddim_steps, settings.iterations, settings.warmup) == (50, 400, 50)
    assert (settings.learning_rate, settings.jerk_weight, settings.decorrelation_weight) == (0.05, 0.5, 1000.0)
    assert (settings.keep, settings.stop_below, settings.guidance, settings.hand) == ("last", None, 1.0, "right")
    kept = [dno_paper(trained).ddim_steps for trained in (10, 50, 1000)]
    assert kept == [10, 50, 10], "the baseline keeps ten steps of a long schedule"


@pytest.mark.parametrize("trained", [2, 10, 50, 1000])
def test_the_fast_mode_spends_at_most_400_passes(trained):
    settings = fast(trained)
    assert settings.ddim_steps <= trained
    assert settings.ddim_steps * (settings.iterations + 1) <= 400
    assert settings.checkpointing == 0


def test_options_change_a_preset_and_the_warmup_keeps_its_share():
    given = {"iterations": "200", "hand": "nearest", "decorrelation": "0", "alpha": "0.1"}
    settings = optimisation_settings(given, paper(50), diffusion_steps=50)
    assert (settings.iterations, settings.warmup) == (200, 25)
    assert (settings.hand, settings.decorrelation_weight, settings.jerk_weight) == ("nearest", 0.0, 0.1)
    assert settings.learning_rate == 0.05


@pytest.mark.parametrize(
    ("key", "value"), [("ddim-steps", "51"), ("iterations", "0"), ("hand", "both"), ("alpha", "-1")]
)
def test_an_impossible_value_is_refused_by_name(key, value):
    with pytest.raises(ValueError, match=f"option '{key}'"):
        optimisation_settings({key: value}, paper(50), diffusion_steps=50)


def test_every_option_changes_something_and_none_changes_nothing():
    for preset in (paper(50), fast(50), dno_paper(1000)):
        assert optimisation_settings({}, preset, diffusion_steps=1000) == preset
    other = {
        "ddim-steps": "3", "iterations": "9", "learning-rate": "1", "alpha": "2", "decorrelation": "3",
        "hand": "left", "bones": "initial", "reach": "goal",
    }  # fmt: skip
    assert set(other) == {*KEYFRAME_OPTIONS, *PRIME_AND_REACH_OPTIONS}
    preset = OptimisationSettings()
    for key, value in other.items():
        assert optimisation_settings({key: value}, preset, diffusion_steps=50) != preset, key


LENGTH = torch.tensor([5])


def _prime_and_reach(joints, targets, **settings):
    return prime_and_reach(joints, LENGTH, targets, OptimisationSettings(**settings))


def _standing(frames=5, batch=1):
    return torch.zeros(batch, frames, 22, 3)


def _wanted(**changes):
    zeros = torch.zeros(1, 22, 3)
    given = {"initial_joints": zeros, **changes}
    if "goal_joints" not in given:
        given.setdefault("goal_location", torch.zeros(1, 3))
    return Targets(**given)


def test_losses_are_means_of_squared_distances():
    joints = _standing()
    joints[0, 0, Joint.HEAD] = torch.tensor([0.3, 0.0, 0.4])  # one joint of 22, half a metre away
    joints[0, -1, Joint.RIGHT_WRIST] = torch.tensor([0.0, 0.2, 0.0])
    losses = _prime_and_reach(joints, _wanted(), jerk_weight=0.0)
    assert losses.initial.item() == pytest.approx(0.25 / 22)
    assert losses.goal.item() == pytest.approx(0.04)
    assert losses.minimised.item() == pytest.approx(0.25 / 22 + 0.04)
    pose = _prime_and_reach(joints, _wanted(goal_joints=torch.zeros(1, 22, 3)), jerk_weight=0.0)
    assert pose.goal.item() == pytest.approx(0.04 / 22)


def test_jerk_is_the_largest_third_difference():
    joints = _standing()
    joints[0, 2, Joint.HEAD, 1] = 0.1  # differences: +3 and -3 times, so 0.3
    assert largest_jerk(joints, LENGTH).item() == pytest.approx(0.3)
    assert _prime_and_reach(joints, _wanted(), jerk_weight=0.5).minimised.item() == pytest.approx(0.15)


def test_the_power_norm_of_jerks_is_above_their_maximum_and_reaches_every_jerky_place():
    joints = _standing(12)
    joints[0, 2, Joint.HEAD, 1], joints[0, 8, Joint.NECK, 1] = 0.1, 0.1
    lengths = torch.tensor([12])
    joints.requires_grad_()
    norm = jerk_norm(joints, lengths, 8.0)
    assert norm.item() == pytest.approx(0.3 * (4 + 3 / 3**8) ** 0.125)  # 3, 3 and 1 tenths; 3, 3, 1 and 1
    (gradient,) = torch.autograd.grad(norm.sum(), joints)
    assert gradient[0, 2, Joint.HEAD].norm() > 0 < gradient[0, 8, Joint.NECK].norm()
    assert torch.isfinite(gradient).all()
    assert jerk_norm(_standing(12), lengths, 8.0).item() == pytest.approx(0.0, abs=1e-9)


def test_too_few_frames_have_no_jerk_and_a_motion_at_rest_has_a_gradient_without_nan():
    for frames in (1, 3):
        assert largest_jerk(_standing(frames), torch.tensor([frames])).item() == 0.0
    joints = _standing().requires_grad_()
    (gradient,) = torch.autograd.grad(largest_jerk(joints, LENGTH).sum(), joints)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize(
    ("objective", "hand"), [(prime_and_reach, "right"), (prime_and_reach, "nearest"), (keyframes, "right")]
)
def test_padding_leaves_no_trace(objective, hand):
    settings = OptimisationSettings(hand=hand)
    joints = torch.randn(1, 9, 22, 3, generator=torch.Generator().manual_seed(0))
    short, padded = (objective(part, LENGTH, _wanted(), settings) for part in (joints[:, :5], joints))
    for name in ("minimised", "initial", "goal"):
        torch.testing.assert_close(getattr(short, name), getattr(padded, name))
    joints.requires_grad_()
    (gradient,) = torch.autograd.grad(objective(joints, LENGTH, _wanted(), settings).minimised.sum(), joints)
    assert gradient[:, 5:].abs().max() == 0.0


@pytest.mark.parametrize(("hand", "distance"), [("left", 0.1), ("right", 0.5), ("nearest", 0.1)])
def test_the_hand_decides_which_wrist_is_measured(hand, distance):
    joints = _standing()
    joints[0, -1, Joint.LEFT_WRIST, 0], joints[0, -1, Joint.RIGHT_WRIST, 0] = 0.1, 0.5
    losses = _prime_and_reach(joints, _wanted(), hand=hand)
    assert losses.goal.item() == pytest.approx(distance**2)


def test_the_soft_minimum_pulls_the_nearer_wrist_only_once_it_is_clearly_nearer():
    joints = _standing()
    joints[0, -1, Joint.LEFT_WRIST, 0], joints[0, -1, Joint.RIGHT_WRIST, 0] = 0.2, 0.8
    joints.requires_grad_()
    losses = _prime_and_reach(joints, _wanted(), jerk_weight=0.0, hand="nearest")
    assert losses.minimised.item() <= losses.goal.item()
    (gradient,) = torch.autograd.grad(losses.minimised.sum(), joints)
    assert gradient[0, -1, Joint.LEFT_WRIST, 0].item() == pytest.approx(0.4, rel=1e-3)
    assert gradient[0, -1, Joint.RIGHT_WRIST, 0].abs().item() < 1e-9


def test_keyframes_are_mean_absolute_errors_over_all_coordinates_asked_for():
    joints = _standing()
    joints[0, 0, 0, 0], joints[0, -1, Joint.RIGHT_WRIST, 1] = 0.69, -0.69
    settings = OptimisationSettings()
    assert keyframes(joints, LENGTH, _wanted(), settings).minimised.item() == pytest.approx(2 * 0.69 / 69)
    pose = keyframes(joints, LENGTH, _wanted(goal_joints=torch.zeros(1, 22, 3)), settings)
    assert pose.minimised.item() == pytest.approx(2 * 0.69 / 132)
    with pytest.raises(ValueError, match="either a goal pose or a goal location"):
        _wanted(goal_joints=torch.zeros(1, 22, 3), goal_location=torch.zeros(1, 3))


@pytest.mark.parametrize(("frames", "expected"), [((1.0, -1.0, 1.0, -1.0), 1.0), ((1.0, 2.0, 3.0, 4.0), 63.5625)])
def test_two_cases_worked_by_hand(frames, expected):
    assert decorrelation(torch.tensor(frames).reshape(1, 4, 1)).item() == pytest.approx(expected)


def _streams(*seeds):
    return [named_generator("prbench-decorrelation", seed) for seed in seeds]


def test_a_smoothed_gradient_spreads_over_neighbouring_frames_of_its_own_sequence():
    spike = torch.zeros(2, 9, 1)
    spike[:, 4] = 1.0
    found = smoothed_over_time(spike, torch.tensor([9, 5]), 1.0)[..., 0]
    assert torch.allclose(found[0], found[0].flip(0))
    assert found[0, 4] == found[0].max() < 0.5
    # The last frame of the shorter sequence has neighbours on one side alone.
    assert found[1, 4] == pytest.approx(1 / (1 + np.exp(-(np.arange(1, 5) ** 2) / 2).sum()), rel=1e-5)
    assert torch.allclose(smoothed_over_time(spike, torch.tensor([9, 9]), 1.0)[1, :, 0], found[0])


def test_each_sequence_is_padded_from_its_own_stream_whatever_the_batch():
    given, lengths = noise(3, 20), torch.tensor([20, 9, 16])
    together = _streams(5, 6, 7)
    first, second = (padded_decorrelation(given, lengths, together) for _ in range(2))
    for row in range(3):
        alone = _streams(5 + row)
        for expected in (first, second):
            own = padded_decorrelation(given[row : row + 1], lengths[row : row + 1], alone)
            torch.testing.assert_close(own, expected[row : row + 1])
    assert first[0] != second[0], "the padding is drawn anew each time"
    torch.testing.assert_close(first[2:], decorrelation(given[2:, :16]), msg="a power of two is not padded")
    torch.testing.assert_close(first[2], second[2], rtol=0, atol=0)


def test_the_gradient_reaches_the_sequences_own_frames_only():
    given = noise(1, 12).requires_grad_()
    (gradient,) = torch.autograd.grad(padded_decorrelation(given, torch.tensor([9]), _streams(1)).sum(), given)
    assert gradient[0, 9:].abs().max() == 0.0
    assert (gradient[0, :9].abs() > 0).any(dim=-1).all()


@pytest.mark.parametrize(
    ("step", "factor"), [(0, 0.0), (25, 0.49520), (50, 0.96194), (200, 0.5), (399, 1.54e-5), (400, 0.0)]
)
def test_learning_rate_factors_worked_by_hand(step, factor):
    assert learning_rate_factor(step, warmup=50, iterations=400) == pytest.approx(factor, rel=2e-3, abs=1e-12)


SETTINGS = OptimisationSettings(iterations=50, warmup=5, learning_rate=0.5, decorrelation_weight=10.0, jerk_weight=0.01)


def _targets(batch, *, goal=(0.4, 1.0, 0.6)):
    zeros = torch.zeros(batch, 22, 3)
    return _wanted(initial_joints=zeros, goal_location=torch.tensor([goal] * batch))


class Trace:
    """What an optimisation reports of its iterations."""

    def __init__(self):
        self.noises, self.losses, self.numbers = [], [], []

    def __call__(self, noise, losses, numbers):
        self.noises.append(noise)
        self.losses.append(losses)
        self.numbers.append(numbers)


def _solve(start, settings=SETTINGS, *, targets=None, lengths=None, seeds=None, watch=None):
    lengths = torch.full((len(start),), start.shape[1]) if lengths is None else torch.tensor(lengths)
    return optimise(
        LinearDecoder(),
        prime_and_reach,
        _targets(len(start)) if targets is None else targets,
        start,
        lengths,
        range(len(start)) if seeds is None else seeds,
        settings,
        watch=watch,
    )


def test_fifty_iterations_lower_the_goal_loss_more_than_tenfold():
    trace = Trace()
    found = _solve(noise(3, 12), watch=trace)
    assert (found.goal < trace.losses[0].goal / 10).all()
    wrist = found.joints[:, -1, 21]
    torch.testing.assert_close((wrist - torch.tensor([0.4, 1.0, 0.6])).square().sum(-1), found.goal)


def test_sequences_do_not_influence_one_another():
    start, lengths = noise(3, 12), [12, 7, 9]
    together = _solve(start, lengths=lengths)
    for row, length in enumerate(lengths):
        alone = _solve(start[row : row + 1, :length], lengths=[length], seeds=[row])
        torch.testing.assert_close(together.noise[row, :length], alone.noise[0], rtol=0, atol=1e-5)
        assert torch.equal(together.noise[row, length:], start[row, length:]), "padding is never moved"


def test_a_sequence_that_is_finished_leaves_and_the_others_go_on_as_before():
    start = noise(2, 12)
    start[0, 0, :66], start[0, -1, 63:66] = 0.0, torch.tensor([4.0, 10.0, 6.0])  # meets its targets from the start
    settings = replace(SETTINGS, stop_below=1e-6)
    trace = Trace()
    found, alone = _solve(start, settings, watch=trace), _solve(start[1:], settings, seeds=[1])
    assert found.network_passes[0] == 1
    assert found.network_passes[1] == alone.network_passes[0]
    assert [numbers["rows"].tolist() for numbers in trace.numbers[:2]] == [[0, 1], [1]]
    assert _solve(start[[0, 0]], settings).network_passes.tolist() == [1, 1]
    torch.testing.assert_close(found.noise[0], start[0])
    torch.testing.assert_close(found.noise[1], alone.noise[0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("met", ["initial", "goal"])
def test_one_of_the_two_losses_is_not_enough_to_finish(met):
    start = noise(1, 12)
    if met == "initial":
        start[:, 0, :66] = 0.0
    else:
        start[:, -1, 63:66] = torch.tensor([4.0, 10.0, 6.0])
    trace = Trace()
    _solve(start, replace(SETTINGS, stop_below=1e-6, iterations=3), watch=trace)
    assert getattr(trace.losses[0], met)[0] < 1e-6
    assert len(trace.losses) == 3


def test_without_a_gradient_nothing_becomes_nan():
    start = torch.zeros(1, 8, 70)
    targets = _targets(1, goal=(0.0, 0.0, 0.0))
    trace = Trace()
    found = _solve(start, replace(SETTINGS, decorrelation_weight=0.0), targets=targets, watch=trace)
    assert torch.isfinite(found.noise).all()
    torch.testing.assert_close(found.noise, start, rtol=0, atol=0)
    assert all((numbers["gradient_norm"] == 0).all() for numbers in trace.numbers)


def test_the_best_iterate_is_kept_even_if_later_ones_are_worse():
    settings = replace(SETTINGS, learning_rate=8.0)  # overshoots
    trace = Trace()
    last, best = _solve(noise(2, 12), settings), _solve(noise(2, 12), replace(settings, keep="best"), watch=trace)
    seen = torch.stack([losses.initial + losses.goal for losses in trace.losses]).amin(dim=0)
    assert ((best.initial + best.goal) <= seen + 1e-7).all()
    assert ((best.initial + best.goal) <= (last.initial + last.goal) + 1e-7).all()
    decoded = LinearDecoder()(best.noise)
    torch.testing.assert_close(decoded, best.joints)


def test_steps_equal_those_of_torchs_adam_on_gradients_of_length_one():
    start = noise(1, 5)
    settings = replace(SETTINGS, iterations=20, warmup=0, decorrelation_weight=0.0)
    parameter = start.clone().requires_grad_()
    official = torch.optim.Adam([parameter])
    for step in range(20):
        losses = prime_and_reach(LinearDecoder()(parameter), torch.tensor([5]), _targets(1), settings)
        (gradient,) = torch.autograd.grad(losses.minimised.sum(), parameter)
        parameter.grad = gradient / gradient.norm()
        official.param_groups[0]["lr"] = 0.5 * (np.cos(np.pi * step / 20) + 1) / 2
        official.step()
    torch.testing.assert_close(_solve(start, settings).noise, parameter.detach(), rtol=0, atol=1e-4)


PUBLISHED = OptimisationSettings(
    ddim_steps=10, iterations=60, learning_rate=0.05, warmup=50, decorrelation_weight=1000.0, guidance=2.5
)


@dataclass
class GoldenModel:
    denoiser: Denoiser
    mean: torch.Tensor
    std: torch.Tensor

    def joints(self, normalised, condition, n_frames, **_):
        return tensors.decode(normalised * self.std + self.mean)


@pytest.fixture(scope="module")
def arrays(samples):
    return golden.load(samples, "dno_optimisation")


@pytest.fixture(scope="module")
def solved(arrays):
    """The whole run, 60 iterations."""
    trace = Trace()
    trace.found = _published(arrays, PUBLISHED, trace)
    return trace


def _published(arrays, settings, watch):
    network = golden.denoiser(arrays, diffusion_steps=1000)
    model = GoldenModel(network, torch.from_numpy(arrays["mean"]), torch.from_numpy(arrays["std"]))
    noise, target = golden.features(arrays["z0"]), torch.from_numpy(arrays["target"])
    text = torch.from_numpy(arrays["text"]).expand(len(noise), 1, -1)
    condition = EncodedCondition(text, torch.zeros(text.shape[:2], dtype=torch.bool))
    return optimise_noise(
        model,
        condition,
        _wanted(initial_joints=target[:, 0], goal_location=target[:, -1, 21].contiguous()),
        torch.full((len(noise),), noise.shape[1]),
        noise,
        settings,
        seeds=range(len(noise)),
        objective=keyframes,
        watch=watch,
    )


def test_the_noise_after_five_steps_and_at_the_end(arrays, solved):
    torch.testing.assert_close(solved.noises[5], golden.features(arrays["z_after_5"]), rtol=0, atol=1e-5)
    torch.testing.assert_close(solved.found.noise, golden.features(arrays["z_final"]), rtol=0, atol=2e-2)


def test_losses_decorrelation_and_gradient_norms_of_all_iterations(arrays, solved):
    minimised = torch.stack([losses.minimised.detach() for losses in solved.losses], dim=1)
    np.testing.assert_allclose(minimised, arrays["loss"], rtol=0, atol=2e-4)
    of_all = {name: [numbers[name] for numbers in solved.numbers] for name in solved.numbers[0]}
    decorrelated = torch.stack(of_all["decorrelation"], dim=1).detach()
    np.testing.assert_allclose(decorrelated, arrays["decorrelation"], rtol=0, atol=2e-6)
    norms = torch.stack(of_all["gradient_norm"], dim=1)
    np.testing.assert_allclose(norms[:, :20], arrays["grad_norm"][:, :20], rtol=1e-3)  # then chaotic
    np.testing.assert_allclose(of_all["learning_rate"], arrays["lr"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("size", [64, 128])
def test_decorrelation_equals_the_reference(samples, size):
    with np.load(samples / "metrics" / "noise_optimisation.npz", allow_pickle=False) as file:
        noise, expected = file[f"z{size}"], file[f"loss{size}"]
    frames_first = torch.from_numpy(noise[:, :, 0]).transpose(1, 2).double()
    np.testing.assert_allclose(decorrelation(frames_first).numpy(), expected, rtol=0, atol=1e-8)
