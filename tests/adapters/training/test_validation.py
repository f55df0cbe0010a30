"""Validation: losses over the chosen sequences, and the benchmark's own metrics of the module's adapter."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
import torch

from prbench.errors import UsageError
from prbench_adapters.training.configuration import (
    DataConfiguration,
    OptimisationConfiguration,
    TrainingConfiguration,
    ValidationConfiguration,
)
from prbench_adapters.training.validation import Validation
from tests.adapters.training.toy import toy
from tests.fakes import fake_dataset

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


def changed(**changes):
    return msgspec.structs.replace(
        CONFIGURATION, validation=msgspec.structs.replace(CONFIGURATION.validation, **changes)
    )


def measured(tables, configuration=CONFIGURATION):
    validation = Validation.prepare(tables, configuration)
    return validation.measure(toy().eval(), torch.device("cpu"))


def chosen_ids(table, n):
    from prbench.sequences.table import by_share

    rows = table.scalars(split="validation")
    return set(by_share(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist())[:n])


def test_losses_are_means_over_sequences_whatever_the_batches(table):
    module = toy().eval()
    losses = {}
    for size in (1, 4):
        validation = Validation.prepare([table], changed(batch_size=size))
        module.generator = lambda step: torch.Generator().manual_seed(0)  # the same noise, to compare the sums alone
        by_hand = [module(_batch(validation, [place]), 0)["loss"].item() for place in validation.places]
        losses[size] = validation.measure(module, torch.device("cpu"))["loss"]
        assert len(by_hand) == 4
        if size == 1:
            assert losses[1] == pytest.approx(np.mean(by_hand), rel=1e-5)
    assert losses[4] == pytest.approx(losses[1], rel=0.2), "other padding draws other noise, but not another loss"


def _batch(validation, places):
    from prbench_adapters.training.dataset import collate

    return collate([validation.data[place] for place in places])


def test_measuring_twice_gives_the_same_numbers(table):
    assert measured([table]) == measured([table])


def test_tables_without_validation_sequences_are_left_out_unless_it_is_all_of_them(table, tmp_path):
    one_recording = fake_dataset(tmp_path / "one", 6, recordings=1, dataset="synthetic-one")
    assert measured([one_recording, table]) == measured([table])
    with pytest.raises(UsageError, match=r"no table has sequences in split 'validation'.*validation\.every=0"):
        Validation.prepare([one_recording], CONFIGURATION)
