"""All compared methods are trained alike: the same data, as many sequences, as many parameters."""

from __future__ import annotations

import json

import pytest

from prbench_adapters.diffusion.method import bundled_weights
from prbench_adapters.training.configuration import TrainingConfiguration, load_configuration

COMPARED = ("mdm", "gmd", "dart", "wandr")


def _small(method: str) -> TrainingConfiguration:
    return load_configuration("small", package=f"prbench_adapters.{method}", task=method, stage="finetune")


def _card(name: str) -> dict:
    return json.loads(bundled_weights(name).with_suffix(".json").read_text("utf-8"))


@pytest.mark.parametrize("method", COMPARED)
def test_small_networks_see_as_many_sequences_as_the_p_and_r_model_does(method):
    own, theirs = _small(method), _small("pr")
    assert own.data == theirs.data
    for key in ("steps", "batch_size", "learning_rate", "warmup_steps", "ema", "seed"):
        assert getattr(own.training, key) == getattr(theirs.training, key), key


@pytest.mark.parametrize("name", ["pr-small-goal-pose", "mdm-small", "gmd-small", "dart-small", "wandr-small"])
def test_bundled_weights_have_seen_what_those_of_p_and_r_have(name):
    theirs, own = _card("pr-small-goal-loc"), _card(name)
    assert [table["content_digest"] for table in own["data"]] == [table["content_digest"] for table in theirs["data"]]
    assert own["steps"] == theirs["steps"]
    for key in ("batch_size", "learning_rate", "warmup_steps", "ema"):
        assert own["configuration"]["training"][key] == theirs["configuration"]["training"][key], key
    assert own["parameters"] == pytest.approx(theirs["parameters"], rel=0.15)  # as many as fit into a file
