"""What the bundled WANDR weights can do on people and rooms that are not in their training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

from prbench.contract import Condition, ConditionBatch
from prbench.curation import build_from_sources
from prbench.geometry.skeleton import Joint
from prbench.harness.conditions import ConditionSource, run_salt
from prbench.harness.methods.loading import load_adapter
from prbench.harness.methods.motions import generate_checked
from prbench.harness.planning import select
from prbench.harness.synthetic_table import Staging, synthetic_source
from prbench.sequences import SequenceTable
from prbench_adapters.diffusion.method import own_weights
from prbench_adapters.wandr import adapter
from tests.adapters.cards import described

FOLDER = Path(adapter.__file__).with_name("weights")
NAMES = ("wandr-small", "wandr-small-pretrained")
LARGEST = 2_500_000  # bytes
HELD_OUT = (10, 11, 12)  # recordings of size tiny in ADT's layout that are in the test split of seed 0
SEQUENCES = 16

pytestmark = pytest.mark.skipif(not (FOLDER / "wandr-small.safetensors").is_file(), reason="no weights are bundled")


@pytest.fixture(scope="module")
def held_out(tmp_path_factory: pytest.TempPathFactory) -> ConditionBatch:
    folder = tmp_path_factory.mktemp("held-out") / "table"
    build_from_sources([synthetic_source(Staging("adt", 0), index) for index in HELD_OUT], folder)
    selection = select(SequenceTable.open(folder), split="test", limit=SEQUENCES)
    rows = np.arange(len(selection.sequence_ids))
    assert len(rows) == SEQUENCES
    return ConditionSource.read(selection).batch(
        rows, Condition.GOAL_LOCATION, seed=0, salt=run_salt(0, "held-out"), sample=0
    )


def _start_distance(batch: ConditionBatch) -> Float[np.ndarray, " batch"]:
    assert batch.initial_joints is not None and batch.goal_location is not None  # noqa: PT018
    return np.linalg.norm(batch.initial_joints[:, Joint.RIGHT_WRIST] - batch.goal_location, axis=-1)


def _end_distance(
    batch: ConditionBatch, led_to: Float[np.ndarray, "batch 3"] | None = None
) -> Float[np.ndarray, " batch"]:
    """From the right wrist in the last frame to its own goal, wherever it was led to."""
    assert batch.goal_location is not None
    given = batch if led_to is None else replace(batch, goal_location=led_to)
    ids = tuple(str(row) for row in range(len(batch)))
    adapter = load_adapter("wandr", FOLDER / "wandr-small.safetensors", {}, "cpu")
    motions, _ = generate_checked(adapter, given, seed=0, method="wandr", sequence_ids=ids)
    last = motions.joints[np.arange(len(batch)), batch.n_frames - 1]
    return np.linalg.norm(last[:, Joint.RIGHT_WRIST] - batch.goal_location, axis=-1)


@pytest.mark.unchecked_shapes
def test_the_right_wrist_comes_nearer_to_its_goal_and_not_to_somebody_elses(held_out):
    """Measured: 0.59 and 100 %; led to the goal of the row half the table further, 0.92 and 0.32 m farther off."""
    assert held_out.goal_location is not None
    start, end = _start_distance(held_out), _end_distance(held_out)
    elsewhere = _end_distance(held_out, np.roll(held_out.goal_location, SEQUENCES // 2, axis=0))
    assert np.median(end / start) < 0.65
    assert np.mean(end < start) > 0.8
    assert np.median(elsewhere / start) > 0.85
    assert np.median(elsewhere - end) > 0.2


@pytest.mark.parametrize("name", NAMES)
def test_a_card_describes_its_weights(name):
    card = described(FOLDER / f"{name}.safetensors", largest=LARGEST)
    assert (card["method"], card["finished"]) == ("wandr", True)
    assert {entry["control"] for entry in card["evaluation"] if entry["method"] == "wandr"} == {None, "shuffled-goal"}


def test_the_default_are_the_weights_that_know_prime_and_reach_sequences():
    assert own_weights("wandr", None) == FOLDER / "wandr-small.safetensors"


@pytest.mark.unchecked_shapes
def test_every_body_stands_in_every_frame(held_out):
    """Measured: the lowest head 0.25 m above the pelvis."""
    adapter = load_adapter("wandr", None, {}, "cpu")
    ids = tuple(str(row) for row in range(SEQUENCES))
    motions, _ = generate_checked(adapter, held_out, seed=0, method="wandr", sequence_ids=ids)
    above = motions.joints[:, :, Joint.HEAD, 1] - motions.joints[:, :, Joint.PELVIS, 1]
    lowest = [above[row, :n].min() for row, n in enumerate(held_out.n_frames)]
    assert min(lowest) > 0.1
