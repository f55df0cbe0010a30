from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from prbench_adapters.diffusion.noise_optimisation import OptimisationSettings, Targets, optimise, prime_and_reach
from tests.adapters.diffusion.noise_optimisation.linear import LinearDecoder, noise

SETTINGS = OptimisationSettings(iterations=50, warmup=5, learning_rate=0.5, decorrelation_weight=10.0, jerk_weight=0.01)


def _targets(batch, *, goal=(0.4, 1.0, 0.6)):
    initial = torch.zeros(batch, 22, 3)
    return Targets(
        initial_joints=initial, previous_joints=initial, goal_location=torch.tensor([goal] * batch, dtype=torch.float32)
    )


class Trace:
    """What an optimisation reports of its iterations."""

    def __init__(self):
        self.losses, self.numbers = [], []

    def __call__(self, noise, losses, numbers):
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


def test_a_sequence_that_is_finished_leaves_and_the_others_go_on_as_before():
    start = noise(2, 12)
    start[0, 0, :66], start[0, -1, 63:66] = 0.0, torch.tensor([4.0, 10.0, 6.0])  # meets its targets from the start
    settings = replace(SETTINGS, stop_below=1e-6)
    trace = Trace()
    found, alone = _solve(start, settings, watch=trace), _solve(start[1:], settings, seeds=[1])
    assert found.network_passes[0] == 1
    assert found.network_passes[1] == alone.network_passes[0]
    assert [numbers["rows"].tolist() for numbers in trace.numbers[:2]] == [[0, 1], [1]]
    torch.testing.assert_close(found.noise[0], start[0])
    torch.testing.assert_close(found.noise[1], alone.noise[0], rtol=0, atol=1e-5)


def test_when_all_are_finished_nothing_more_is_computed():
    start = torch.zeros(2, 12, 70)
    start[:, -1, 63:66] = torch.tensor([4.0, 10.0, 6.0])
    found = _solve(start, replace(SETTINGS, stop_below=1e-6))
    assert found.network_passes.tolist() == [1, 1]
    assert (found.goal < 1e-6).all()


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


def test_every_iteration_and_the_last_decoding_are_counted():
    assert _solve(noise(2, 8), replace(SETTINGS, iterations=7)).network_passes.tolist() == [8, 8]


def test_the_first_step_of_the_published_schedule_moves_nothing():
    start = noise(1, 8)
    found = _solve(start, replace(SETTINGS, iterations=1))
    torch.testing.assert_close(found.noise, start, rtol=0, atol=0)


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


def test_what_lies_behind_a_sequence_is_never_moved():
    start = noise(2, 12)
    found = _solve(start, lengths=[12, 6])
    torch.testing.assert_close(found.noise[1, 6:], start[1, 6:], rtol=0, atol=0)
    assert not torch.equal(found.noise[1, :6], start[1, :6])


def test_learning_rates_are_recorded():
    trace = Trace()
    _solve(noise(1, 8), watch=trace)
    rates = [numbers["learning_rate"] for numbers in trace.numbers]
    assert rates[0] == 0.0
    assert rates[5] == pytest.approx(0.5 * (np.cos(np.pi * 5 / 50) + 1) / 2)


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
