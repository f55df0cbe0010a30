from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.contract import Adapter, Condition
from prbench.errors import AdapterError, InputFileError
from prbench_adapters import dart
from prbench_adapters.dart.adapter import parts_of_similar_cost
from prbench_adapters.dart.model import DartConfiguration
from prbench_adapters.diffusion.generation import ModelBodies
from tests.adapters.dart import tiny
from tests.adapters.diffusion.goal_batches import conditions

QUICK = {"iterations": "2"}
BATCH = conditions(Condition.GOAL_LOCATION, 2, frames=(11, 9))
"""Two sequences of one part; the first takes two primitives, the second one."""


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return tiny.write(tmp_path_factory.mktemp("weights") / "dart.safetensors", diffusion_steps=2)


def _generated(weights, batch, **options):
    return dart.load(weights, options={**QUICK, **options}, device="cpu").generate(batch, seed=0)


@pytest.mark.parametrize("condition", [Condition.GOAL_LOCATION, Condition.GOAL_POSE])
def test_motions_start_with_the_initial_pose_and_are_as_long_as_asked(weights, condition):
    batch = conditions(condition, 2, frames=(11, 9))
    adapter = dart.load(weights, options=QUICK, device="cpu")
    assert isinstance(adapter, Adapter)
    assert condition in adapter.conditions
    motions = adapter.generate(batch, seed=0)
    assert motions.joints.shape == (2, 11, 22, 3)
    assert np.isfinite(motions.joints).all()
    assert np.array_equal(motions.joints[:, 0], batch.initial_joints)


def test_passes_of_both_networks_are_declared(weights):
    """Three roll-outs (two iterations and the last) of 2 primitives and of 1, 2 guided steps and a decoding each."""
    assert _generated(weights, BATCH).cost.network_passes == 3 * (2 + 1) * (2 * 2 + 1)
    assert _generated(weights, BATCH, guidance="1").cost.network_passes == 3 * (2 + 1) * (2 * 1 + 1)


@pytest.mark.parametrize(("n_frames", "primitives"), [(1, 1), (2, 1), (10, 1), (11, 2), (18, 2), (242, 30)])
def test_a_motion_takes_as_many_primitives_as_cover_it(n_frames, primitives):
    assert DartConfiguration().primitives_for(n_frames) == primitives


@pytest.mark.parametrize("largest", [1, 7, 20, 1000])
def test_parts_hold_all_rows_once_the_longest_first_and_about_as_much(largest):
    primitives = np.array([3, 1, 5, 5, 2, 4])
    parts = parts_of_similar_cost(primitives, largest)
    assert sorted(np.concatenate(parts).tolist()) == list(range(6))
    assert (np.diff(primitives[np.concatenate(parts)]) <= 0).all()
    assert max(primitives[part].sum() for part in parts) < largest + 5
    assert len(parts) == min(6, -(-20 // largest))


def test_a_sequence_does_not_notice_its_batch(weights):
    together = _generated(weights, BATCH).joints
    for row in range(2):
        alone = _generated(weights, BATCH.rows(row, row + 1)).joints[0]
        np.testing.assert_allclose(together[row, : len(alone)], alone, atol=1e-4)


def test_the_same_batch_gives_the_same_bytes_and_another_seed_another_motion(weights):
    first, again = (_generated(weights, BATCH).joints for _ in range(2))
    assert np.array_equal(first, again)
    other = _generated(weights, replace(BATCH, noise_seed=(5, 6))).joints
    assert not np.allclose(first, other)


def test_without_optimisation_the_goal_is_not_looked_at(weights):
    moved = replace(BATCH, goal_location=BATCH.goal_location + np.float32(0.3))
    free = dart.load(weights, options={"optimise": "off"}, device="cpu")
    assert np.array_equal(free.generate(BATCH, seed=0).joints, free.generate(moved, seed=0).joints)
    assert not np.allclose(_generated(weights, BATCH).joints, _generated(weights, moved).joints)


@pytest.mark.parametrize("change", [{"text": ("sits down",) * 2}, {"previous_joints": BATCH.initial_joints}])
def test_text_and_initial_velocity_matter(weights, change):
    assert not np.allclose(_generated(weights, BATCH).joints, _generated(weights, replace(BATCH, **change)).joints)


def test_fewer_steps_take_fewer_passes(weights):
    assert _generated(weights, BATCH, **{"ddim-steps": "1"}).cost.network_passes == 3 * (2 + 1) * (2 * 1 + 1)


def test_a_model_of_one_skeleton_moves_bodies_of_their_own_size(tmp_path):
    """Conditions are put on the model's skeleton and the motion is scaled back.

    Source: docs/specification/pr-model.md#data-and-features.
    """
    path = tiny.write(tmp_path / "uniform.safetensors", diffusion_steps=2, uniform_skeleton=True)
    adapter = dart.load(path, options=QUICK, device="cpu")
    bodies = ModelBodies.of(BATCH, adapter.model.configuration)
    assert not np.allclose(bodies.batch.goal_location, BATCH.goal_location)
    plain = tiny.write(tmp_path / "plain.safetensors", diffusion_steps=2)
    inside = _generated(plain, bodies.batch).joints
    np.testing.assert_allclose(adapter.generate(BATCH, seed=0).joints, bodies.own(inside), atol=1e-6)


@pytest.mark.parametrize("value", [np.nan, 40.0])
def test_a_goal_out_of_any_reach_is_refused_with_its_row(weights, value):
    goals = BATCH.goal_location.copy()
    goals[1, 2] = value
    with pytest.raises(AdapterError, match=r"adapter 'dart', row 1 .*: expected a goal within 10 m of the first pose"):
        _generated(weights, replace(BATCH, goal_location=goals))


@pytest.mark.parametrize("name", ["initial_joints", "previous_joints"])
@pytest.mark.parametrize(("value", "found"), [(np.nan, "not finite"), (0.0, "one vertical line")])
def test_an_initial_state_without_heading_is_refused(weights, name, value, found):
    poses = getattr(BATCH, name).copy()
    poses[1, 1:3] = value
    with pytest.raises(AdapterError, match=rf"(?s)row 1 .*{found}" if name == "previous_joints" else "row 1"):
        _generated(weights, replace(BATCH, **{name: poses}))


def test_another_frame_rate_is_refused(weights):
    with pytest.raises(AdapterError, match="expected 20 frames per second, found 30"):
        _generated(weights, replace(BATCH, fps=30.0))


@pytest.mark.parametrize(
    ("key", "value"),
    [("optimise", "fast"), ("iterations", "0"), ("hand", "both"), ("iteration", "3")],
)
def test_unknown_options_and_values_are_refused(weights, key, value):
    with pytest.raises(ValueError, match=key):
        dart.load(weights, options={key: value}, device="cpu")


def test_options_of_the_optimisation_need_one(weights):
    with pytest.raises(ValueError, match="'hand' belongs to noise optimisation"):
        dart.load(weights, options={"optimise": "off", "hand": "left"}, device="cpu")


def test_weights_of_a_training_that_knew_no_denoiser_yet_are_refused(tmp_path):
    path = tiny.write(tmp_path / "half.safetensors", latent_std=0.0)
    with pytest.raises(InputFileError, match=r"latent.std: expected a positive number, found 0.*stopped"):
        dart.load(path, options={}, device="cpu")


@pytest.mark.parametrize("change", [{"vae_layers": 4}, {"future_frames": 1}, {"width": 15}, {"layers": 0}])
def test_sizes_that_do_not_fit_together_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        DartConfiguration(**change)
