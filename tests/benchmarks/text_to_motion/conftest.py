from __future__ import annotations

import pytest
import torch

from prbench_adapters.training import LengthBatches, SequenceDataset, collate
from prbench_adapters.training.task import TrainingData
from prbench_adapters.training.weights import write_weights
from prbench_benchmarks.text_to_motion.training import t2m_evaluator
from tests.benchmarks.text_to_motion.corpora import TINY, made_up_corpus


@pytest.fixture(scope="session")
def corpus(tmp_path_factory):
    return made_up_corpus(tmp_path_factory.mktemp("corpus") / "made-up")


@pytest.fixture(scope="session")
def data(corpus, tmp_path_factory):
    dataset = SequenceDataset([corpus], max_frames=60, cache=tmp_path_factory.mktemp("cache"))
    return TrainingData(dataset, mode="continuous", max_frames=60)


@pytest.fixture(scope="session")
def batch(data):
    order = next(iter(LengthBatches(data.train, 8)))
    return collate([data.train[draw] for draw in order])


@pytest.fixture
def build(data):
    """Make a module of a stage, always the same one."""

    def made(stage="full", initial=None, **model):
        chosen = TINY | ({"autoencoder_batches": 2} if stage == "full" else {}) | model
        with torch.random.fork_rng():
            torch.manual_seed(0)
            return t2m_evaluator().build(chosen, data=data, initial=initial, stage=stage)

    return made


@pytest.fixture
def saved(tmp_path):
    """Write a module's weights."""

    def written(module, name="evaluator"):
        path = tmp_path / f"{name}.safetensors"
        write_weights(path, *module.weights(), card={})
        return path

    return written
