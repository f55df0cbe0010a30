from __future__ import annotations

import numpy as np
import pytest

from prbench.contract import Adapter, Condition, ConditionBatch
from prbench.errors import AdapterError
from prbench.geometry.skeleton import Joint, bone_lengths
from prbench_adapters import dno
from prbench_adapters.diffusion.generation import ModelBodies
from prbench_adapters.diffusion.noise_optimisation import keyframes
from prbench_adapters.diffusion.optimised_generation import optimise_batch
from tests.adapters.diffusion import tiny

QUICK = {"iterations": "3", "ddim-steps": "2"}
POSE = np.random.default_rng(0).normal(0.0, 0.3, (22, 3)) + np.array([0.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def prior(tmp_path_factory):
    return tiny.write(tmp_path_factory.mktemp("weights") / "prior.safetensors")


def batch(condition=Condition.GOAL_LOCATION, *, n_frames=(9, 6), goal=(0.3, 1.2, 0.5), **changes):
    n = len(n_frames)
    poses = np.repeat(POSE[None], n, axis=0).astype(np.float32)
    goals = {
        Condition.GOAL_LOCATION: {"goal_location": np.array([goal] * n, dtype=np.float32)},
        Condition.GOAL_POSE: {"goal_joints": poses + np.asarray(goal, dtype=np.float32)},
    }[condition]
    given = {
        "condition": condition,
        "n_frames": np.array(n_frames),
        "fps": 20.0,
        "opaque_id": tuple(map(str, range(n))),
        "noise_seed": tuple(range(n)),
        "text": ("The person moves across and picks an object.",) * n,
        "initial_joints": poses,
        "previous_joints": poses,
        **goals,
    }
    return ConditionBatch(**{**given, **changes})


@pytest.mark.parametrize("condition", [Condition.GOAL_LOCATION, Condition.GOAL_POSE])
def test_it_generates_as_many_frames_as_asked_and_declares_its_passes(prior, condition):
    adapter = dno.load(prior, options=QUICK, device="cpu")
    assert isinstance(adapter, Adapter)
    motions = adapter.generate(batch(condition), seed=0)
    assert motions.joints.shape == (2, 9, 22, 3)
    assert motions.n_frames.tolist() == [9, 6]
    assert np.isfinite(motions.joints).all()
    assert motions.cost.network_passes == 2 * (3 + 1) * 2


@pytest.mark.parametrize("value", [np.nan, 40.0])
def test_a_goal_out_of_any_reach_is_refused_with_its_row(prior, value):
    adapter = dno.load(prior, options=QUICK, device="cpu")
    goals = batch().goal_location.copy()
    goals[1, 2] = value
    with pytest.raises(AdapterError, match=r"adapter 'dno', row 1 .*: expected a goal within 10 m of the first pose"):
        adapter.generate(batch(goal_location=goals), seed=0)


def test_another_goal_gives_another_motion_and_the_wrist_comes_nearer(prior):
    options = {"iterations": "40", "ddim-steps": "2", "decorrelation": "0", "learning-rate": "0.3"}
    adapter = dno.load(prior, options=options, device="cpu")
    near, far = (
        adapter.generate(batch(n_frames=(8,), goal=goal), seed=0) for goal in ((0.1, 1.0, 0.1), (0.5, 1.3, 0.4))
    )
    wrists = [motions.joints[0, -1, Joint.RIGHT_WRIST] for motions in (near, far)]
    assert np.linalg.norm(wrists[0] - [0.1, 1.0, 0.1]) < np.linalg.norm(wrists[1] - [0.1, 1.0, 0.1])
    assert np.linalg.norm(wrists[1] - [0.5, 1.3, 0.4]) < np.linalg.norm(wrists[0] - [0.5, 1.3, 0.4])


def test_the_same_batch_gives_the_same_bytes(prior):
    adapter = dno.load(prior, options=QUICK, device="cpu")
    first, second = (adapter.generate(batch(), seed=seed).joints for seed in (0, 1))
    np.testing.assert_array_equal(first, second)


def test_the_text_is_empty_unless_asked_for(prior):
    def generated(**options):
        adapter = dno.load(prior, options={**QUICK, **options}, device="cpu")
        return [adapter.generate(batch(text=(text,) * 2), seed=0).joints for text in ("picks", "puts")]

    without, own, fixed = generated(), generated(prompt="own"), generated(prompt="picks")
    np.testing.assert_array_equal(without[0], without[1])
    assert not np.array_equal(own[0], own[1])
    np.testing.assert_array_equal(fixed[1], own[0])


def test_guidance_doubles_the_passes(prior):
    adapter = dno.load(prior, options={**QUICK, "guidance": "2.5"}, device="cpu")
    assert adapter.generate(batch(), seed=0).cost.network_passes == 2 * 2 * (3 + 1) * 2


def test_bones_stay_as_long_as_in_the_initial_pose_if_asked_for(prior):
    given = batch(n_frames=(9,))
    expected = bone_lengths(given.initial_joints)
    lengths = {
        bones: bone_lengths(
            dno.load(prior, options={**QUICK, "bones": bones}, device="cpu").generate(given, seed=0).joints
        )
        for bones in ("predicted", "initial")
    }
    np.testing.assert_allclose(lengths["initial"], np.repeat(expected[:, None], 9, axis=1), rtol=1e-4)
    assert not np.allclose(lengths["predicted"], expected[:, None], rtol=0.05)


def test_the_modes_are_those_of_the_page(prior, tmp_path):
    def settings(path, **options):
        return dno.load(path, options=options, device="cpu").settings

    assert settings(prior).ddim_steps * (settings(prior).iterations + 1) <= 400
    paper = settings(prior, optimise="paper")
    assert (paper.ddim_steps, paper.iterations, paper.learning_rate) == (8, 400, 0.05)
    long = tiny.write(tmp_path / "long.safetensors", diffusion_steps=1000)
    assert settings(long, optimise="paper").ddim_steps == 10


def test_a_prior_of_one_skeleton_moves_bodies_of_their_own_size(tmp_path):
    """Goals and poses are put on the prior's skeleton and the motion is scaled back.

    Source: docs/specification/pr-model.md#data-and-features.
    """
    path = tiny.write(tmp_path / "uniform.safetensors", uniform_skeleton=True)
    adapter, given = dno.load(path, options=QUICK, device="cpu"), batch(n_frames=(9,))
    bodies = ModelBodies.of(given, adapter.model.configuration)
    assert not np.allclose(bodies.batch.goal_location, given.goal_location)
    inside = optimise_batch(adapter.model, bodies.batch, adapter.settings, objective=keyframes, texts=("",))
    np.testing.assert_allclose(adapter.generate(given, seed=0).joints, bodies.own(inside.joints.numpy()), atol=1e-6)


def test_weights_that_know_goals_are_refused(tmp_path):
    path = tiny.write(tmp_path / "pr.safetensors", goal="location")
    with pytest.raises(AdapterError, match="goal"):
        dno.load(path, options={}, device="cpu")


def test_a_sequence_that_is_too_long_is_refused(prior):
    adapter = dno.load(prior, options=QUICK, device="cpu")
    with pytest.raises(AdapterError, match="at most 40 frames"):
        adapter.generate(batch(n_frames=(41,)), seed=0)


@pytest.mark.parametrize(
    ("key", "value"), [("optimise", "slow"), ("hand", "both"), ("promt", "x"), ("guidance", "-1"), ("alpha", "1")]
)
def test_unknown_options_and_values_are_refused(prior, key, value):
    with pytest.raises(ValueError, match=key):
        dno.load(prior, options={key: value}, device="cpu")
