"""The average of the weights and the learning rate, against values worked by hand."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from prbench_adapters.training.configuration import OptimisationConfiguration
from prbench_adapters.training.state import WeightAverage, learning_rate


def test_the_rate_rises_linearly_then_falls_as_half_a_cosine():
    settings = OptimisationConfiguration(steps=8, warmup_steps=4, learning_rate=1.0, schedule="cosine")
    rates = [learning_rate(step, settings) for step in range(8)]
    assert rates == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0, (1 + 0.5**0.5) / 2, 0.5, (1 - 0.5**0.5) / 2])


def test_a_constant_rate_stays_after_the_warm_up():
    settings = OptimisationConfiguration(steps=5, warmup_steps=2, learning_rate=0.4)
    assert [learning_rate(step, settings) for step in range(5)] == pytest.approx([0.2, 0.4, 0.4, 0.4, 0.4])


def walked(values, decay, *, warmup):
    """The average of a single weight that takes on ``values`` after its start at 0."""
    module = nn.Linear(1, 1, bias=False)
    nn.init.zeros_(module.weight)
    average = WeightAverage(module, decay, warmup=warmup)
    for step, value in enumerate(values):
        nn.init.constant_(module.weight, value)
        average.update(step + 1)
    return float(average.averages["weight"])


def test_the_average_follows_its_recurrence():
    assert walked([1.0, 2.0], 0.75, warmup=False) == pytest.approx(0.75 * 0.25 + 0.25 * 2)


def test_the_warm_up_forgets_the_start_sooner():
    # (1 + n) / (10 + n) is 2/11 after the first step and 3/12 after the second
    assert walked([1.0, 2.0], 0.75, warmup=True) == pytest.approx(0.25 * (9 / 11) + 0.75 * 2)
    assert walked([1.0] * 400, 0.75, warmup=True) == pytest.approx(walked([1.0] * 400, 0.75, warmup=False))


def test_no_decay_follows_the_weights():
    assert walked([1.0, 5.0], 0.0, warmup=False) == 5.0


def test_the_average_takes_the_place_of_the_weights_and_gives_it_back_even_after_an_error():
    module = nn.Linear(3, 3)
    before = module.weight.clone()
    average = WeightAverage(module, 0.5)
    with torch.no_grad():
        module.weight.add_(1.0)
    after = module.weight.clone()

    def fail() -> None:
        with average.applied():
            assert torch.equal(module.weight, before)
            raise RuntimeError("in between")

    with pytest.raises(RuntimeError, match="in between"):
        fail()
    assert torch.equal(module.weight, after)
    assert torch.equal(average.averages["weight"], before)
