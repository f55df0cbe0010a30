"""All compared methods are trained alike: the same data, as many steps, as many parameters."""

from __future__ import annotations

import json

import pytest

from prbench.training.configuration import TrainingConfiguration, load_configuration
from prbench_adapters.diffusion.bundled import bundled_names, bundled_weights

COMPARED = ("gmd", "dart", "wandr")
HISTORY_OF_P_AND_R = ("mdm-small-pretrained", "mdm-small", "pr-small-goal-pose")
"""Each was trained from the one before."""


def _small(method: str, stage: str) -> TrainingConfiguration:
    return load_configuration("small", package=f"prbench_adapters.{method}", task=method, stage=stage)


def _card(name: str) -> dict:
    return json.loads(bundled_weights(name).with_suffix(".json").read_text("utf-8"))


@pytest.mark.parametrize("stage", ["pretrain", "finetune"])
@pytest.mark.parametrize("method", COMPARED)
def test_small_networks_see_batches_as_the_p_and_r_model_does(method, stage):
    own, theirs = _small(method, stage), _small("pr", stage)
    assert own.data == theirs.data
    for key in ("batch_size", "learning_rate", "warmup_steps", "ema", "seed"):
        assert getattr(own.training, key) == getattr(theirs.training, key), key


@pytest.mark.parametrize("method", COMPARED)
def test_small_networks_take_as_many_steps_as_the_bundled_p_and_r_model_for_poses(method):
    steps = sum(_small(method, stage).training.steps for stage in ("pretrain", "finetune"))
    assert steps == sum(_card(name)["steps"] for name in HISTORY_OF_P_AND_R)


@pytest.mark.parametrize("method", [method for method in COMPARED if f"{method}-small" in bundled_names()])
def test_cards_say_the_same(method):
    before, after = _card(f"{method}-small-pretrained"), _card(f"{method}-small")
    theirs = _card("mdm-small-pretrained"), _card("pr-small-goal-pose")
    for own, other in zip((before, after), theirs, strict=True):
        seen, theirs_seen = ({table["content_digest"] for table in card["data"]} for card in (own, other))
        assert seen == theirs_seen
        assert own["parameters"] == pytest.approx(other["parameters"], rel=0.1)
    assert before["steps"] + after["steps"] == sum(_card(name)["steps"] for name in HISTORY_OF_P_AND_R)
    assert after["initial_weights_sha256"] == before["weights_sha256"]
