"""What the bundled GMD weights can do on people and rooms that are not in their training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.curation import build_from_sources
from prbench.geometry.skeleton import Joint, bone_lengths
from prbench.harness.conditions import ConditionSource, run_salt
from prbench.harness.methods.loading import load_adapter
from prbench.harness.methods.motions import generate_checked
from prbench.harness.planning import select
from prbench.harness.synthetic_table import Staging, synthetic_source
from prbench.sequences import SequenceTable
from prbench_adapters.gmd import adapter
from prbench_adapters.gmd.model import GMDModel
from tests.adapters.cards import described

FOLDER = Path(adapter.__file__).with_name("weights")
NAMES = ("gmd-small", "gmd-small-pretrained")
LARGEST = 2_500_000  # bytes
HELD_OUT = (29, 25)  # recordings of the embedded ADT table that are in its test split, with short sequences
SEQUENCES = 8
NEAR = 0.1  # metres
FEW = "20"  # of 100 steps, for all that they cost

pytestmark = pytest.mark.skipif(not (FOLDER / "gmd-small.safetensors").is_file(), reason="no weights are bundled")


@pytest.fixture(scope="module")
def held_out(tmp_path_factory: pytest.TempPathFactory) -> ConditionBatch:
    """The shortest sequences: what they show does not depend on their length, but what they cost does."""
    folder = tmp_path_factory.mktemp("held-out") / "table"
    build_from_sources([synthetic_source(Staging("adt", 0), index) for index in HELD_OUT], folder)
    selection = select(SequenceTable.open(folder), split="test", limit=None)
    rows = np.sort(np.argsort(selection.n_frames, kind="stable")[:SEQUENCES])
    source, salt = ConditionSource.read(selection), run_salt(0, "held-out")
    assert len(rows) == SEQUENCES
    return source.batch(rows, Condition.GOAL_POSE, seed=0, salt=salt, sample=0)


def _motions(batch: ConditionBatch, *, name: str = "gmd-small", **options: str) -> Motions:
    ids = tuple(str(row) for row in range(len(batch)))
    method = load_adapter("gmd", FOLDER / f"{name}.safetensors", options, "cpu")
    motions, _ = generate_checked(method, batch, seed=0, method="gmd", sequence_ids=ids)
    return motions


def _off_the_keyframes(
    batch: ConditionBatch, *, name: str = "gmd-small", led_to: np.ndarray | None = None, **options: str
) -> Float[np.ndarray, "2 batch"]:
    """How far the root is from the first and from the last keyframe, metres; motions may be led to other goals."""
    given = batch if led_to is None else replace(batch, goal_joints=led_to)
    return _apart(batch, _motions(given, name=name, **options))


def _apart(batch: ConditionBatch, motions: Motions) -> Float[np.ndarray, "2 batch"]:
    assert batch.initial_joints is not None and batch.goal_joints is not None  # noqa: PT018
    last = motions.joints[np.arange(len(batch)), batch.n_frames - 1]
    ends = ((motions.joints[:, 0], batch.initial_joints), (last, batch.goal_joints))
    ground = [(found - wanted)[:, Joint.PELVIS, ::2] for found, wanted in ends]
    return np.linalg.norm(ground, axis=-1)


@pytest.fixture(scope="module")
def in_few_steps(held_out: ConditionBatch) -> Motions:
    return _motions(held_out, steps=FEW)


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_the_root_is_at_both_keyframes_in_every_sequence(held_out, in_few_steps):
    assert _apart(held_out, in_few_steps).max() < NEAR


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_every_body_stands_and_is_whole(held_out, in_few_steps):
    """Measured: the lowest head 0.50 m above the pelvis; the largest change of a bone 17 %, median over bodies."""
    joints = [in_few_steps.joints[row, :n] for row, n in enumerate(held_out.n_frames)]
    above = [(each[:, Joint.HEAD, 1] - each[:, Joint.PELVIS, 1]).min() for each in joints]
    lengths = [bone_lengths(each) for each in joints]
    changes = [np.abs(each / each[0] - 1.0).max() for each in lengths]
    assert min(above) > 0.3
    assert np.median(changes) < 0.3


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_so_it_is_in_all_steps_as_the_method_runs_without_options(held_out):
    assert _off_the_keyframes(held_out.rows(0, 1)).max() < NEAR


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_the_root_ends_elsewhere_when_it_is_led_to_the_goal_of_another(held_out):
    """``--control shuffled-goal``; the keyframe in the first frame is nobody else's."""
    assert held_out.goal_joints is not None
    first, last = _off_the_keyframes(held_out, led_to=np.roll(held_out.goal_joints, 1, axis=0), steps=FEW)
    assert first.max() < NEAR
    assert np.median(last) > 5 * NEAR


@pytest.mark.slow
def test_the_pretrained_weights_keep_to_the_keyframes_too(held_out):
    """The goal is no condition of the networks, so fine-tuning does not decide whether it is met."""
    assert _off_the_keyframes(held_out.rows(0, 2), name="gmd-small-pretrained", steps=FEW).max() < NEAR


@pytest.mark.parametrize("name", NAMES)
def test_weights_are_those_of_the_small_configuration(name):
    model = GMDModel.load(FOLDER / f"{name}.safetensors")
    assert model.configuration.diffusion_steps == 100
    assert model.configuration.max_frames == 241
    assert model.configuration.text_encoder == "hashed-ngrams"
    assert bool((model.space.std > 0).all())
    assert float(model.space.std[1]) == float(model.space.std[2])


@pytest.mark.parametrize("name", NAMES)
def test_a_card_describes_its_weights(name):
    card = described(FOLDER / f"{name}.safetensors", largest=LARGEST)
    assert (card["method"], card["finished"]) == ("gmd", True)


def test_the_default_are_the_weights_that_know_prime_and_reach_sequences():
    assert adapter.load(None, options={}, device="cpu").weights == FOLDER / "gmd-small.safetensors"
