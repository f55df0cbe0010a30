"""What the bundled weights of the predictors can do on people and rooms that are not in their training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import prbench_adapters.prediction
from prbench.curation import build_from_sources
from prbench.harness.synthetic_table import Staging, synthetic_source
from prbench_adapters.prediction.adapter import load_predictor
from prbench_benchmarks.motion_prediction.anchored import build_anchored_windows
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.predictors import ZeroVelocity
from prbench_benchmarks.motion_prediction.scoring import score_predictor
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.adapters.cards import described

FOLDER = Path(prbench_adapters.prediction.__file__).with_name("weights")
WEIGHTS = {
    "gazemodiff-small-pose": ("gazemodiff", Condition.POSE),
    "gazemodiff-small-pose-head": ("gazemodiff", Condition.POSE_HEAD),
    "gazemodiff-small-pose-gaze": ("gazemodiff", Condition.POSE_GAZE),
    "humanmac-small": ("humanmac", Condition.POSE),
    "cvae-small": ("cvae", Condition.POSE),
    "dlow-small": ("dlow", Condition.POSE),
    "belfusion-small": ("belfusion", Condition.POSE),
    "humanmac-small-pose-gaze": ("humanmac", Condition.POSE_GAZE),
    "belfusion-small-pose-gaze": ("belfusion", Condition.POSE_GAZE),
    "gazemotion-small": ("gazemotion", Condition.POSE_GAZE),
}
LARGEST = 1_000_000  # bytes
HELD_OUT = (1, 4, 8)  # recordings of size tiny in ADT's layout that are in the test split of seed 0
WINDOWS = 12
SAMPLES = 20
DESIGN = {"dlow-small": 50}
"""Samples that are one design, and come together."""


@pytest.mark.parametrize("name", WEIGHTS)
def test_a_card_describes_its_weights(name):
    card = described(FOLDER / f"{name}.safetensors", largest=LARGEST)
    assert (card["method"], card["finished"]) == (WEIGHTS[name][0], True)
    assert card["evaluation"]


def test_every_bundled_file_is_looked_at_here():
    assert {path.stem for path in FOLDER.glob("*.safetensors")} == set(WEIGHTS)


@pytest.mark.parametrize("method", sorted({method for method, _ in WEIGHTS.values()}))
def test_a_predictor_without_weights_takes_those_that_come_with_it(method):
    predictor = load_predictor(method, None, options={}, device="cpu")
    assert predictor.conditions == {condition for own, condition in WEIGHTS.values() if own == method}


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> WindowsTable:
    folder = tmp_path_factory.mktemp("held-out")
    build_from_sources([synthetic_source(Staging("adt", 0), index) for index in HELD_OUT], folder / "table")
    build_anchored_windows(folder / "table", folder / "windows", only=("event-1.5",))
    return WindowsTable.open(folder / "windows")


@pytest.mark.slow
@pytest.mark.unchecked_shapes
@pytest.mark.parametrize("name", WEIGHTS)
def test_one_of_its_futures_is_nearer_than_standing_still(name, windows):
    method, condition = WEIGHTS[name]
    chosen = windows.chosen(split="test")[:WINDOWS]
    predictor = load_predictor(method, FOLDER / f"{name}.safetensors", options={}, device="cpu")
    found, still = (
        np.array(score_predictor(each, windows, condition, chosen, n_samples=n).columns["ade"])
        for each, n in ((predictor, DESIGN.get(name, SAMPLES)), (ZeroVelocity(), 1))
    )
    assert found.mean() < 0.7 * still.mean()
