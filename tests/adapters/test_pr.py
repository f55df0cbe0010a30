"""The adapter `pr`: weights by condition, what changes a motion and what may not, options, refusals."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from prbench.contract import Condition, Motions
from prbench.errors import AdapterError, InputFileError
from prbench.geometry.skeleton import BONES, Joint
from prbench_adapters.diffusion import method
from prbench_adapters.pr import PR, load
from tests.adapters.diffusion import tiny
from tests.adapters.diffusion.goal_batches import conditions

SAMPLING = {"optimise": "off"}
GOALS = {Condition.GOAL_LOCATION: "location", Condition.GOAL_POSE: "pose"}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> dict[Condition, Path]:
    folder = tmp_path_factory.mktemp("weights")
    return {condition: tiny.write(folder / f"{goal}.safetensors", goal=goal) for condition, goal in GOALS.items()}


def _generate(adapter: PR, condition: Condition, **changes: object) -> Motions:
    return adapter.generate(dataclasses.replace(conditions(condition), **changes), seed=0)


def _largest_change(first: Motions, second: Motions) -> float:
    return float(np.abs(first.ragged() - second.ragged()).max())


@pytest.mark.parametrize("condition", list(GOALS))
def test_motions_are_finite_and_as_long_as_asked(weights, condition):
    motions = _generate(load(weights[condition], options=SAMPLING, device="cpu"), condition)
    assert np.array_equal(motions.n_frames, conditions(condition).n_frames)
    assert np.isfinite(motions.ragged()).all()
    assert motions.cost is not None
    assert motions.cost.network_passes == 3 * 8  # one pass a step: guidance 1


@pytest.mark.parametrize("condition", list(GOALS))
def test_the_motion_depends_on_its_goal(weights, condition):
    adapter = load(weights[condition], options=SAMPLING, device="cpu")
    field = "goal_location" if condition is Condition.GOAL_LOCATION else "goal_joints"
    moved = getattr(conditions(condition), field) + np.float32(0.5)
    assert _largest_change(_generate(adapter, condition), _generate(adapter, condition, **{field: moved})) > 1e-3


@pytest.mark.parametrize(("key", "value"), [("reach", "goal"), ("feet", "predicted")])
def test_arms_and_feet_are_chosen_only_with_weights_that_can(weights, key, value):
    with pytest.raises(AdapterError, match=f"option '{key}'.* expected a model of goal-frame features"):
        load(weights[Condition.GOAL_LOCATION], options={**SAMPLING, key: value}, device="cpu")


@pytest.fixture(scope="module")
def few_steps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of goal-frame features that make a motion in two passes."""
    features = {"architecture": "frames", "features": "goal-frame", "goal": "location", "diffusion_steps": 2}
    return tiny.write(tmp_path_factory.mktemp("few") / "few.safetensors", **features)


def test_one_pass_takes_the_passes_of_the_weights_and_nothing_else(few_steps):
    adapter = load(few_steps, options={"sampler": "one-pass"}, device="cpu")
    motions = _generate(adapter, Condition.GOAL_LOCATION)
    assert motions.cost is not None
    assert motions.cost.network_passes == 3 * 2
    walked = load(few_steps, options={**SAMPLING, "sampler": "ddim"}, device="cpu")
    assert _largest_change(motions, _generate(walked, Condition.GOAL_LOCATION)) == 0.0
    said_twice = load(few_steps, options={**SAMPLING, "sampler": "one-pass"}, device="cpu")
    assert _largest_change(motions, _generate(said_twice, Condition.GOAL_LOCATION)) == 0.0


def test_one_pass_is_refused_for_weights_of_many_steps(weights):
    with pytest.raises(AdapterError, match=r"1 to 4 network passes, but weights .*location\.safetensors need 8\. "):
        load(weights[Condition.GOAL_LOCATION], options={"sampler": "one-pass"}, device="cpu")


@pytest.mark.parametrize(
    "more", [{"optimise": "fast"}, {"optimise": "paper"}, {"guidance": "2"}, {"steps": "1"}, {"iterations": "3"}]
)
def test_one_pass_is_combined_with_nothing_that_adds_or_saves_passes(few_steps, more):
    with pytest.raises(ValueError, match=f"option '{next(iter(more))}'"):
        load(few_steps, options={"sampler": "one-pass", **more}, device="cpu")


def test_leading_a_wrist_to_the_goal_changes_the_last_half_second_alone(few_steps):
    batch = conditions(Condition.GOAL_LOCATION)
    assert batch.goal_location is not None
    one_pass = {"sampler": "one-pass"}
    predicted = _generate(load(few_steps, options=one_pass, device="cpu"), batch.condition)
    led = _generate(load(few_steps, options={**one_pass, "reach": "goal"}, device="cpu"), batch.condition)
    for row, n in enumerate(batch.n_frames):
        unchanged = n - 1 - round(0.5 * batch.fps)
        before = (led.joints[row, : unchanged + 1], predicted.joints[row, : unchanged + 1])
        np.testing.assert_allclose(*before, rtol=0, atol=1e-6)
        wrists = led.joints[row, n - 1, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]]
        assert np.linalg.norm(wrists - batch.goal_location[row], axis=1).min() < 0.06
        assert np.abs(led.joints[row, n - 1] - predicted.joints[row, n - 1]).max() > 0.01


@pytest.mark.parametrize("field", ["initial_joints", "previous_joints"])
def test_the_motion_depends_on_its_initial_state(weights, field):
    adapter = load(weights[Condition.GOAL_LOCATION], options=SAMPLING, device="cpu")
    batch = conditions(Condition.GOAL_LOCATION)
    moved = getattr(batch, field) + np.float32(0.02)
    changed = _generate(adapter, Condition.GOAL_LOCATION, **{field: moved})
    assert _largest_change(_generate(adapter, Condition.GOAL_LOCATION), changed) > 1e-3


@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
def test_the_same_seed_gives_the_same_motion_in_any_batch(weights, sampler):
    adapter = load(weights[Condition.GOAL_LOCATION], options={**SAMPLING, "sampler": sampler}, device="cpu")
    batch = conditions(Condition.GOAL_LOCATION, 8)
    together = adapter.generate(batch, seed=0)
    for row in range(8):
        alone = adapter.generate(batch.rows(row, row + 1), seed=99)  # the run's seed is recorded only
        n = int(batch.n_frames[row])
        assert np.abs(alone.joints[0, :n] - together.joints[row, :n]).max() < 1e-4


def test_another_noise_seed_gives_another_motion(weights):
    adapter = load(weights[Condition.GOAL_LOCATION], options=SAMPLING, device="cpu")
    other = _generate(adapter, Condition.GOAL_LOCATION, noise_seed=(1, 2, 3))
    assert _largest_change(_generate(adapter, Condition.GOAL_LOCATION), other) > 1e-3


@pytest.mark.parametrize("dropped", ["goal", "initial_pose", "initial_velocity", "text"])
def test_a_dropped_condition_changes_nothing(tmp_path, dropped):
    path = tiny.write(tmp_path / "dropped.safetensors", goal="location", dropped=(dropped,))
    adapter = load(path, options=SAMPLING, device="cpu")
    batch = conditions(Condition.GOAL_LOCATION)
    shift = np.float32(0.05)
    changes = {
        "goal": {"goal_location": batch.goal_location + shift},
        # both frames move together: the pose is another one, the velocity the same
        "initial_pose": {
            "initial_joints": batch.initial_joints + shift,
            "previous_joints": batch.previous_joints + shift,
        },
        "initial_velocity": {"previous_joints": batch.previous_joints + shift},
        "text": {"text": tuple("The person moves across and puts an object." for _ in batch.text)},
    }
    before = _generate(adapter, Condition.GOAL_LOCATION)
    for name, change in changes.items():
        moved = _largest_change(before, _generate(adapter, Condition.GOAL_LOCATION, **change))
        assert (moved < 1e-4) if name == dropped else (moved > 1e-4), name


def test_without_weights_the_condition_chooses_the_bundled_ones(weights, monkeypatch):
    files = {"pr-small-goal-loc": Condition.GOAL_LOCATION, "pr-small-goal-pose": Condition.GOAL_POSE}
    monkeypatch.setattr(method, "bundled_weights", lambda name, folder: weights[files[name]])
    adapter = load(None, options=SAMPLING, device="cpu")
    for condition in GOALS:
        assert adapter.weights_for(condition) == weights[condition]
        assert _generate(adapter, condition).joints.shape[0] == 3


def test_weights_for_the_other_goal_are_refused_with_both_names(weights):
    adapter = load(weights[Condition.GOAL_POSE], options=SAMPLING, device="cpu")
    with pytest.raises(AdapterError, match=r"pose\.safetensors: expected a model of goal 'location' for 'goal-loc'"):
        _generate(adapter, Condition.GOAL_LOCATION)


def test_weights_without_a_goal_are_refused(tmp_path):
    with pytest.raises(AdapterError, match="expected a model of goal location or pose, found one of goal 'none'"):
        load(tiny.write(tmp_path / "text.safetensors"), options=SAMPLING, device="cpu")


def test_weights_that_name_another_representation_are_refused(tmp_path):
    named = {"representation": "rotations-135/continuous"}
    path = tiny.write(tmp_path / "other.safetensors", goal="location", metadata=named)
    with pytest.raises(InputFileError, match=r"'humanml3d-263/continuous'.*'rotations-135/continuous'"):
        load(path, options=SAMPLING, device="cpu")


@pytest.mark.parametrize("value", [np.nan, np.inf, 40.0])
def test_a_goal_out_of_any_reach_is_refused_with_its_row(weights, value):
    adapter = load(weights[Condition.GOAL_LOCATION], options=SAMPLING, device="cpu")
    goals = conditions(Condition.GOAL_LOCATION).goal_location.copy()
    goals[1, 2] = value
    with pytest.raises(AdapterError, match=r"row 1 of the batch .*: expected a goal within 10 m of the first pose"):
        _generate(adapter, Condition.GOAL_LOCATION, goal_location=goals)


def test_a_goal_above_any_hand_is_refused(weights):
    adapter = load(weights[Condition.GOAL_LOCATION], options=SAMPLING, device="cpu")
    goals = conditions(Condition.GOAL_LOCATION).goal_location.copy()
    goals[1, 1] = 4.0
    with pytest.raises(AdapterError, match=r"row 1 of the batch .* and 3 m of the floor"):
        _generate(adapter, Condition.GOAL_LOCATION, goal_location=goals)


def test_a_goal_pose_with_one_lost_joint_is_refused(weights):
    adapter = load(weights[Condition.GOAL_POSE], options=SAMPLING, device="cpu")
    goals = conditions(Condition.GOAL_POSE).goal_joints.copy()
    goals[2, 21, 0] = np.nan
    with pytest.raises(AdapterError, match="row 2"):
        _generate(adapter, Condition.GOAL_POSE, goal_joints=goals)


def test_a_sequence_longer_than_the_model_is_refused(tmp_path):
    path = tiny.write(tmp_path / "short.safetensors", goal="location", max_frames=20)
    adapter = load(path, options=SAMPLING, device="cpu")
    assert adapter.max_frames == 20
    with pytest.raises(AdapterError, match="at most 20 frames, and was asked for 30"):
        _generate(adapter, Condition.GOAL_LOCATION)


def test_noise_optimisation_is_the_default_and_comes_closer_to_the_goal(weights):
    path = weights[Condition.GOAL_LOCATION]
    plain = _generate(
        load(path, options={**SAMPLING, "sampler": "ddim", "steps": "4"}, device="cpu"), Condition.GOAL_LOCATION
    )
    optimised = _generate(
        load(path, options={"iterations": "8", "ddim-steps": "4"}, device="cpu"), Condition.GOAL_LOCATION
    )
    goal = conditions(Condition.GOAL_LOCATION).goal_location

    def wrist_error(motions: Motions) -> np.ndarray:
        last = motions.joints[np.arange(3), motions.n_frames - 1]
        return np.linalg.norm(last[:, 21] - goal, axis=1)

    assert wrist_error(optimised).mean() < wrist_error(plain).mean()


def test_the_left_hand_can_be_asked_for(weights):
    path = weights[Condition.GOAL_LOCATION]
    right, left = (
        _generate(
            load(path, options={"iterations": "2", "ddim-steps": "2", "hand": hand}, device="cpu"),
            Condition.GOAL_LOCATION,
        )
        for hand in ("right", "left")
    )
    assert _largest_change(right, left) > 1e-3


@pytest.mark.parametrize("options", [SAMPLING, {"iterations": "2", "ddim-steps": "2"}])
def test_bones_can_keep_the_lengths_of_the_initial_pose(weights, options):
    path, batch = weights[Condition.GOAL_LOCATION], conditions(Condition.GOAL_LOCATION)
    parents, children = np.transpose(BONES)

    def lengths(joints: np.ndarray) -> np.ndarray:
        return np.linalg.norm(joints[..., children, :] - joints[..., parents, :], axis=-1)

    predicted = _generate(load(path, options=options, device="cpu"), batch.condition)
    kept = _generate(load(path, options={**options, "bones": "initial"}, device="cpu"), batch.condition)
    own = np.repeat(lengths(batch.initial_joints), batch.n_frames, axis=0)
    assert np.abs(lengths(kept.ragged()) - own).max() < 1e-5
    assert np.abs(lengths(predicted.ragged()) - own).max() > 1e-2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"guidence": "2"}, "unknown option 'guidence'. Did you mean 'guidance'"),
        ({"initial-frames": "2"}, "unknown option 'initial-frames'"),
        ({"optimise": "off", "hand": "left"}, "'hand' belongs to noise optimisation"),
        ({"optimise": "fast", "sampler": "ddim"}, "'sampler' belongs to sampling without noise optimisation"),
        ({"steps": "5"}, "'steps' belongs to sampling without noise optimisation"),
        ({"feet": "steps"}, "'feet' belongs to sampling without noise optimisation"),
        ({"noise-scale": "2"}, "'noise-scale' belongs to sampling without noise optimisation"),
        ({"optimise": "off", "noise-scale": "-1"}, "option 'noise-scale': expected a number of 0 or more, found '-1'"),
        ({"optimise": "off", "sampler": "heun"}, "expected ddpm or ddim or one-pass, found 'heun'"),
        ({"optimise": "slow"}, "option 'optimise': expected"),
        ({"hand": "both"}, "option 'hand': expected"),
        ({"optimise": "off", "steps": "9"}, "from 1 to 8, found '9'"),
    ],
)
def test_options_that_make_no_sense_are_refused(weights, options, message):
    with pytest.raises(ValueError, match=message):
        load(weights[Condition.GOAL_LOCATION], options=options, device="cpu")
