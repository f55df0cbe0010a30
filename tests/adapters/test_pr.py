"""The adapter `pr`: weights by condition, what changes a motion and what may not, options, refusals."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from prbench.contract import Condition, Motions
from prbench.errors import AdapterError
from prbench.geometry.skeleton import Joint
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


@pytest.fixture(scope="module")
def few_steps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of goal-frame features that make a motion in two passes."""
    features = {"architecture": "frames", "features": "goal-frame", "goal": "location", "diffusion_steps": 2}
    return tiny.write(tmp_path_factory.mktemp("few") / "few.safetensors", **features)


def test_one_pass_takes_the_passes_of_the_weights_and_nothing_else(few_steps):
    ways = ({"sampler": "one-pass"}, {**SAMPLING, "sampler": "ddpm"}, {**SAMPLING, "sampler": "one-pass"})
    found = [_generate(load(few_steps, options=way, device="cpu"), Condition.GOAL_LOCATION) for way in ways]
    assert found[0].cost is not None
    assert found[0].cost.network_passes == 3 * 2
    assert _largest_change(found[0], found[1]) == _largest_change(found[0], found[2]) == 0.0


@pytest.mark.parametrize(
    "more", [{"optimise": "fast"}, {"optimise": "paper"}, {"guidance": "2"}, {"steps": "1"}, {"iterations": "3"}]
)
def test_one_pass_is_combined_with_nothing_that_adds_or_saves_passes(few_steps, more):
    with pytest.raises(ValueError, match=f"option '{next(iter(more))}'"):
        load(few_steps, options={"sampler": "one-pass", **more}, device="cpu")


def test_one_pass_is_refused_for_weights_of_many_steps(tmp_path):
    features = {"architecture": "frames", "features": "goal-frame", "goal": "location", "diffusion_steps": 17}
    with pytest.raises(AdapterError, match=r"1 to 16 network passes, but weights .*many\.safetensors need 17\. "):
        load(tiny.write(tmp_path / "many.safetensors", **features), options={"sampler": "one-pass"}, device="cpu")


def test_leading_a_wrist_to_the_goal_changes_the_last_half_second_alone(few_steps):
    batch = conditions(Condition.GOAL_LOCATION)
    assert batch.goal_location is not None
    one_pass = {"sampler": "one-pass", "feet": "predicted"}
    predicted = _generate(load(few_steps, options=one_pass, device="cpu"), batch.condition)
    led = _generate(load(few_steps, options={**one_pass, "reach": "goal"}, device="cpu"), batch.condition)
    for row, n in enumerate(batch.n_frames):
        unchanged = n - 1 - round(0.5 * batch.fps)
        before = (led.joints[row, : unchanged + 1], predicted.joints[row, : unchanged + 1])
        np.testing.assert_allclose(*before, rtol=0, atol=1e-6)
        wrists = led.joints[row, n - 1, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]]
        assert np.linalg.norm(wrists - batch.goal_location[row], axis=1).min() < 0.06
        assert np.abs(led.joints[row, n - 1] - predicted.joints[row, n - 1]).max() > 0.01


@pytest.mark.parametrize("part", ["bones", "feet", "first", "smooth"])
@pytest.mark.parametrize("way", [{"sampler": "one-pass"}, {"optimise": "fast", "iterations": "1"}])
def test_each_part_that_is_constructed_can_be_switched_off(few_steps, part, way):
    constructed = _generate(load(few_steps, options=way, device="cpu"), Condition.GOAL_LOCATION)
    alone = _generate(load(few_steps, options={**way, part: "predicted"}, device="cpu"), Condition.GOAL_LOCATION)
    assert _largest_change(constructed, alone) > 1e-3


@pytest.mark.parametrize("dropped", ["goal", "initial_pose", "initial_velocity", "text"])
def test_a_dropped_condition_changes_nothing(tmp_path, dropped):
    path = tiny.write(tmp_path / "dropped.safetensors", goal="location", dropped=(dropped,))
    adapter = load(path, options={**SAMPLING, "bones": "predicted"}, device="cpu")
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


def test_noise_optimisation_is_the_default_and_brings_the_hand_that_is_asked_for_closer_to_the_goal(weights):
    path, goal = weights[Condition.GOAL_LOCATION], conditions(Condition.GOAL_LOCATION).goal_location

    def missed(wrist: Joint, **options: str) -> float:
        given = {key.replace("_", "-"): value for key, value in options.items()}
        motions = _generate(load(path, options=given, device="cpu"), Condition.GOAL_LOCATION)
        last = motions.joints[np.arange(3), motions.n_frames - 1]
        return float(np.linalg.norm(last[:, wrist] - goal, axis=1).mean())

    plain = {"optimise": "off", "sampler": "ddim", "steps": "4"}
    solved = {"iterations": "8", "ddim_steps": "4"}
    assert missed(Joint.RIGHT_WRIST, **solved) < missed(Joint.RIGHT_WRIST, **plain)
    assert missed(Joint.LEFT_WRIST, **solved, hand="left") < missed(Joint.LEFT_WRIST, **solved)
