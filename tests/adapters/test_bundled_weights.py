"""The weights that come with prbench: small, described by their cards, of the kind that their names say."""

from __future__ import annotations

import pytest

from prbench_adapters.diffusion.method import bundled_names, bundled_weights
from prbench_adapters.diffusion.model import MotionModel
from tests.adapters.cards import described

GOALS = {
    "mdm-small": "none",
    "mdm-small-pretrained": "none",
    "pr-small-goal-loc": "location",
    "pr-small-goal-pose": "pose",
}
LARGEST = 2_500_000  # bytes
PROTOCOL_FRAMES = 241


def test_the_methods_find_their_default_weights():
    assert set(GOALS) <= set(bundled_names())


@pytest.mark.parametrize("name", GOALS)
def test_a_card_describes_its_weights(name):
    card = described(bundled_weights(name), largest=LARGEST)
    assert card["learning_curve"][-1]["loss"] < card["learning_curve"][0]["loss"]
    assert card["evaluation"]


@pytest.mark.parametrize(("name", "goal"), GOALS.items())
def test_weights_are_of_the_kind_that_their_name_says(name, goal):
    model = MotionModel.load(bundled_weights(name), "cpu")
    assert model.configuration.goal == goal
    assert model.configuration.max_frames == PROTOCOL_FRAMES
    assert model.configuration.text_encoder == "hashed-ngrams"
    assert bool((model.std > 0).all())
