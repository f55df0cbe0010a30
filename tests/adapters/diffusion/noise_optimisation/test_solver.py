from __future__ import annotations

import pytest
import torch

from prbench_adapters.diffusion.noise_optimisation.optimise import (
    DecorrelationPadding,
    decorrelation,
    learning_rate_factor,
    power_of_two_above,
)
from tests.adapters.diffusion.noise_optimisation.linear import noise


@pytest.mark.parametrize(("frames", "expected"), [((1.0, -1.0, 1.0, -1.0), 1.0), ((1.0, 2.0, 3.0, 4.0), 63.5625)])
def test_two_cases_worked_by_hand(frames, expected):
    assert decorrelation(torch.tensor(frames).reshape(1, 4, 1)).item() == pytest.approx(expected)


def test_lengths_that_are_powers_of_two_are_not_padded():
    given = noise(2, 16)
    padding = DecorrelationPadding([1, 2], torch.tensor([16, 16]))
    torch.testing.assert_close(padding.loss(given), decorrelation(given))


def test_each_sequence_is_padded_from_its_own_stream_whatever_the_batch():
    given, lengths = noise(3, 20), torch.tensor([20, 9, 16])
    together = DecorrelationPadding([5, 6, 7], lengths)
    first, second = together.loss(given), together.loss(given)
    for row in range(3):
        alone = DecorrelationPadding([5 + row], lengths[row : row + 1])
        torch.testing.assert_close(alone.loss(given[row : row + 1]), first[row : row + 1])
        torch.testing.assert_close(alone.loss(given[row : row + 1]), second[row : row + 1])
    assert first[0] != second[0], "the padding is drawn anew each time"
    assert first[2] == second[2]


def test_rows_that_stay_go_on_with_their_streams():
    given, lengths = noise(2, 12), torch.tensor([12, 12])
    whole, halved = DecorrelationPadding([1, 2], lengths), DecorrelationPadding([1, 2], lengths)
    whole.loss(given)
    halved.loss(given)
    torch.testing.assert_close(halved.rows([1]).loss(given[1:]), whole.loss(given)[1:])


def test_the_gradient_reaches_the_sequences_own_frames_only():
    given = noise(1, 12).requires_grad_()
    (gradient,) = torch.autograd.grad(DecorrelationPadding([1], torch.tensor([9])).loss(given).sum(), given)
    assert gradient[0, 9:].abs().max() == 0.0
    assert (gradient[0, :9].abs() > 0).any(dim=-1).all()


@pytest.mark.parametrize(("length", "padded"), [(1, 1), (2, 2), (3, 4), (150, 256), (256, 256), (257, 512)])
def test_the_next_power_of_two(length, padded):
    assert power_of_two_above(length) == padded


@pytest.mark.parametrize(
    ("step", "factor"), [(0, 0.0), (25, 0.49520), (50, 0.96194), (200, 0.5), (399, 1.54e-5), (400, 0.0)]
)
def test_learning_rate_factors_worked_by_hand(step, factor):
    assert learning_rate_factor(step, warmup=50, iterations=400) == pytest.approx(factor, rel=2e-3, abs=1e-12)
