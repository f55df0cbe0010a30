"""The task ``motion-tokens``: what it learns, resumes, stores and refuses."""

from __future__ import annotations

import dataclasses
from itertools import islice, repeat

import pytest
import torch

from prbench.errors import InputFileError, TableError, UsageError
from prbench.harness.methods.installed import load_task
from prbench_adapters.training import LengthBatches, SequenceDataset, collate
from prbench_adapters.training.configuration import (
    OptimisationConfiguration,
    TrainingConfiguration,
    ValidationConfiguration,
    list_configurations,
    load_configuration,
)
from prbench_adapters.training.loop import fit
from prbench_adapters.training.task import TrainingData, TrainingTask, split_model_table
from prbench_adapters.training.weights import write_weights
from prbench_benchmarks.motion_tokens.network import TokeniserConfiguration
from prbench_benchmarks.motion_tokens.training import TokeniserObjective, TokeniserTask, load_tokeniser
from tests.benchmarks.text_to_motion.corpora import made_up_corpus

TINY = {"width": 8, "latent": 8, "codes": 16, "parts": 2, "window": 16, "max_frames": 60}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpus") / "made-up"
    dataset = SequenceDataset([made_up_corpus(folder)], max_frames=60, cache=tmp_path_factory.mktemp("cache"))
    return TrainingData(dataset, mode="continuous", max_frames=60)


@pytest.fixture
def build(data):
    def made(initial=None, **model):
        with torch.random.fork_rng():
            torch.manual_seed(0)
            return TokeniserTask().build(TINY | model, data=data, initial=initial, stage="train")

    return made


@pytest.fixture
def batches(data):
    order = LengthBatches(data.train, 8)
    return lambda start: (collate([data.train[draw] for draw in draws]) for draws in islice(order, start, None))


def configured(steps=6, **settings):
    training = OptimisationConfiguration(steps=steps, learning_rate=3e-3, ema=0.0, save_every=50, **settings)
    return TrainingConfiguration(model=TINY, training=training, validation=ValidationConfiguration(every=2))


def tensors_of(path):
    network, _ = load_tokeniser(path)
    return network.state_dict()


def test_the_loss_falls_and_codes_come_into_use(build, batches, tmp_path):
    batch = next(iter(batches(0)))
    state = fit(build(width=32, codes=32), lambda _: repeat(batch), configured(80, log_every=10), tmp_path)
    assert state.rows[-1]["loss"] < 0.8 * state.rows[0]["loss"]
    assert state.rows[-1]["perplexity"] > 3


def test_an_interrupted_training_ends_with_the_same_bits_codes_sums_and_counts(build, batches, tmp_path):
    whole = fit(build(), batches, configured(), tmp_path / "whole")
    fit(build(), batches, configured(4), tmp_path / "parts")  # ends with a checkpoint
    resumed = fit(build(), batches, configured(), tmp_path / "parts")
    assert whole.module.network.quantisers[0].initialised
    for name, tensor in whole.module.state_dict().items():
        assert torch.equal(tensor, resumed.module.state_dict()[name]), name
    weights = [(tmp_path / name / "weights.safetensors").read_bytes() for name in ("whole", "parts")]
    assert weights[0] == weights[1]


def test_weights_of_the_best_validation_hold_the_codes_of_that_step(build, batches, tmp_path):
    losses = iter([1.0, 2.0, 3.0])
    fit(build(), batches, configured(2), tmp_path / "best", validate=lambda _: {"loss": 0.0})
    fit(build(), batches, configured(6), tmp_path / "all", validate=lambda _: {"loss": next(losses)})
    best, kept = (tensors_of(tmp_path / name / "weights.safetensors") for name in ("best", "all"))
    assert all(torch.equal(tensor, kept[name]) for name, tensor in best.items())


def test_stored_weights_reconstruct_alike_and_training_goes_on_from_their_counts(build, batches, tmp_path):
    module = build()
    batch = next(iter(batches(0)))
    module.train()(batch, 0)
    write_weights(tmp_path / "a.safetensors", *module.weights(), card={})
    network, digest = load_tokeniser(tmp_path / "a.safetensors")
    features = batch.features[:, :20]
    assert len(digest) == 64
    assert torch.equal(network(features)[0], module.eval().network(features)[0])
    again = build(initial=tmp_path / "a.safetensors")
    assert torch.equal(again.network.quantisers[1].count, module.network.quantisers[1].count)
    assert "initial weights a.safetensors" in again.origin[0]
    with pytest.raises(InputFileError, match=r"model\.codes=16"):
        build(initial=tmp_path / "a.safetensors", codes=8)


def test_clips_hold_no_padding_and_are_as_long_as_the_shortest_motion(build, batches):
    batch = next(iter(batches(0)))
    lengths = torch.arange(9, 17)
    features = batch.features.clone()
    for row, length in enumerate(lengths):
        features[row, length:] = torch.nan
    batch = dataclasses.replace(batch, n_frames=lengths, features=features)
    clips = build(windows=3)._clips(batch, torch.Generator().manual_seed(0))
    assert clips.shape == (24, 8, 263)
    assert torch.isfinite(clips).all()


def test_a_step_draws_the_same_again(build, batches):
    module, batch = build().eval(), next(iter(batches(0)))
    losses = [module(batch, step)["loss"].item() for step in (3, 3, 4)]
    assert losses[0] == losses[1] != losses[2]


def test_a_motion_without_a_token_is_named(build, batches):
    batch = next(iter(batches(0)))
    short = dataclasses.replace(batch, n_frames=torch.where(torch.arange(8) == 5, 3, batch.n_frames))
    with pytest.raises(TableError, match=rf"{batch.sequence_id[5]}: expected 4 frames or more, found 3"):
        build()(short, 0)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"parts": 3}, "`parts` must be 1 or 2"),
        ({"latent": 7}, "found 2 parts of 7 channels"),
        ({"window": 30}, "`window` must be a multiple of 4"),
        ({"codes": 0}, "'codes' must be at least 1"),
        ({"commitment": -1.0}, "'commitment' must be at least 0"),
        ({"fps": 30.0}, "frames per second of the tables"),
        ({"depth": 3}, "depth"),
    ],
)
def test_what_is_no_tokeniser_is_refused(build, model, message):
    with pytest.raises(UsageError, match=message):
        build(**model)


def test_several_processes_are_refused(build, monkeypatch):
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    with pytest.raises(UsageError, match="--devices 1"):
        build()


def test_the_task_is_installed_with_its_configurations():
    task = load_task("motion-tokens")
    assert isinstance(task, TrainingTask)
    names = list_configurations(task.configurations, task.name)
    assert names == ("paper", "small", "smoke")
    for name in names:
        found = load_configuration(name, package=task.configurations, task=task.name, stage="train")
        split_model_table(found.model, TokeniserConfiguration, TokeniserObjective)
