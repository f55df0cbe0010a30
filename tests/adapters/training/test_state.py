"""State and settings of a training: averages, learning rates, the table of the model, validation."""

from __future__ import annotations

from typing import Literal

import msgspec
import numpy as np
import pytest
import torch
from torch import nn

from prbench.errors import UsageError
from prbench_adapters.training.configuration import (
    DataConfiguration,
    OptimisationConfiguration,
    TrainingConfiguration,
    ValidationConfiguration,
)
from prbench_adapters.training.dataset import collate
from prbench_adapters.training.run import Validation
from prbench_adapters.training.state import WeightAverage, learning_rate
from prbench_adapters.training.task import split_model_table
from tests.adapters.training.toy import toy
from tests.fakes import fake_dataset


def test_the_rate_rises_linearly_then_stays_halves_or_falls_as_half_a_cosine():
    cosine = OptimisationConfiguration(steps=8, warmup_steps=4, learning_rate=1.0, schedule="cosine")
    falling = [0.25, 0.5, 0.75, 1.0, 1.0, (1 + 0.5**0.5) / 2, 0.5, (1 - 0.5**0.5) / 2]
    constant = OptimisationConfiguration(steps=5, warmup_steps=2, learning_rate=0.4)
    halving = OptimisationConfiguration(steps=9, warmup_steps=3, learning_rate=3.0, schedule="halving")
    halved = [1.0, 2.0, 3.0, 3.0, 1.5, 0.75, 0.375, 0.1875, 0.09375]
    for settings, rates in ((cosine, falling), (constant, [0.2, 0.4, 0.4, 0.4, 0.4]), (halving, halved)):
        assert [learning_rate(step, settings) for step in range(settings.steps)] == pytest.approx(rates)


def walked(values, decay, *, warmup):
    """The average of a single weight that takes on ``values`` after its start at 0."""
    module = nn.Linear(1, 1, bias=False)
    nn.init.zeros_(module.weight)
    average = WeightAverage(module, decay, warmup=warmup)
    for step, value in enumerate(values):
        nn.init.constant_(module.weight, value)
        average.update(step + 1)
    return float(average.averages["weight"])


def test_the_average_follows_its_recurrence_and_its_warm_up_forgets_the_start_sooner():
    """(1 + n) / (10 + n) is 2/11 after the first step and 3/12 after the second."""
    assert walked([1.0, 2.0], 0.75, warmup=False) == pytest.approx(0.75 * 0.25 + 0.25 * 2)
    assert walked([1.0, 5.0], 0.0, warmup=False) == 5.0
    assert walked([1.0, 2.0], 0.75, warmup=True) == pytest.approx(0.25 * (9 / 11) + 0.75 * 2)
    assert walked([1.0] * 400, 0.75, warmup=True) == pytest.approx(walked([1.0] * 400, 0.75, warmup=False))


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


class Networks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    width: int = 8
    schedule: Literal["cosine", "geometric"] = "cosine"


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.weight < 0:
            raise ValueError("'weight' must be at least 0")


def test_each_record_gets_its_own_keys_and_what_is_not_said_has_its_default():
    assert split_model_table({"weight": 2.0, "width": 3}, Networks, Objective) == (Networks(3), Objective(2.0))
    assert split_model_table({}, Networks, Objective) == (Networks(), Objective())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"widht": 3}, "widht"),
        ({"width": "wide"}, r"Expected `int`, got `str` - at `\$\.width`"),
        ({"weight": -1.0}, "'weight' must be at least 0"),
        ({"schedule": "linear"}, r"Invalid enum value 'linear' - at `\$\.schedule`. It is one of: cosine, geometric\."),
    ],
)
def test_what_describes_nothing_is_refused(wrong, message):
    with pytest.raises(UsageError, match=r"^\[model\]: .*" + message):
        split_model_table(wrong, Networks, Objective)


CONFIGURATION = TrainingConfiguration(
    model={},
    training=OptimisationConfiguration(steps=1),
    data=DataConfiguration(max_frames=60),
    validation=ValidationConfiguration(every=1, sequences=4, batch_size=3),
)


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path_factory.getbasetemp() / "validation-cache"))


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("table") / "data", 48)


def measured(tables):
    return Validation.prepare(tables, CONFIGURATION).measure(toy().eval(), torch.device("cpu"))


def test_losses_are_means_over_sequences_whatever_the_batches(table):
    module = toy().eval()
    losses = {}
    for size in (1, 4):
        settings = msgspec.structs.replace(CONFIGURATION.validation, batch_size=size)
        validation = Validation.prepare([table], msgspec.structs.replace(CONFIGURATION, validation=settings))
        module.generator = lambda step: torch.Generator().manual_seed(0)  # the same noise, to compare the sums alone
        by_hand = [module(collate([validation.data[place]]), 0)["loss"].item() for place in validation.places]
        losses[size] = validation.measure(module, torch.device("cpu"))["loss"]
        assert len(by_hand) == 4
        if size == 1:
            assert losses[1] == pytest.approx(np.mean(by_hand), rel=1e-5)
    assert losses[4] == pytest.approx(losses[1], rel=0.2), "other padding draws other noise, but not another loss"


def test_tables_without_validation_sequences_are_left_out_unless_it_is_all_of_them(table, tmp_path):
    one_recording = fake_dataset(tmp_path / "one", 6, recordings=1, dataset="synthetic-one")
    assert measured([one_recording, table]) == measured([table])
    with pytest.raises(UsageError, match=r"no table has sequences in split 'validation'.*validation\.every=0"):
        Validation.prepare([one_recording], CONFIGURATION)
