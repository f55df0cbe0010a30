from __future__ import annotations

import pytest
import torch

from prbench.randomness import named_generator
from prbench_adapters.diffusion.noise_optimisation import (
    decorrelation,
    learning_rate_factor,
    padded_decorrelation,
)
from tests.adapters.diffusion.noise_optimisation.linear import noise


@pytest.mark.parametrize(("frames", "expected"), [((1.0, -1.0, 1.0, -1.0), 1.0), ((1.0, 2.0, 3.0, 4.0), 63.5625)])
def test_two_cases_worked_by_hand(frames, expected):
    assert decorrelation(torch.tensor(frames).reshape(1, 4, 1)).item() == pytest.approx(expected)


def _streams(*seeds):
    return [named_generator("prbench-decorrelation", seed) for seed in seeds]


def test_lengths_that_are_powers_of_two_are_not_padded():
    given = noise(2, 16)
    found = padded_decorrelation(given, torch.tensor([16, 16]), _streams(1, 2))
    torch.testing.assert_close(found, decorrelation(given))


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
    assert first[2] == second[2]


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
