"""What holds for every method with a network: lengths, costs, seeds, batches, conditions, options, refusals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from prbench.contract import Adapter, Condition, ConditionBatch, Motions
from prbench.errors import AdapterError, InputFileError
from prbench.geometry.skeleton import bone_lengths
from prbench.harness.methods.loading import load_adapter
from prbench_adapters.diffusion import method as bundles
from prbench_adapters.diffusion.generation import ModelBodies
from tests.adapters.dart import tiny as dart
from tests.adapters.diffusion import tiny as denoisers
from tests.adapters.diffusion.goal_batches import conditions
from tests.adapters.gmd import tiny as gmd
from tests.adapters.wandr import tiny as wandr
from tests.shared import made_once

LOCATION, POSE = Condition.GOAL_LOCATION, Condition.GOAL_POSE


@dataclasses.dataclass(frozen=True)
class Method:
    """A method with tiny weights.

    Attributes:
        key: The method's name, and behind a hyphen which case of it this is.
        passes: Network passes of a batch of two sequences, of 11 and 9 frames.
        moved: What changes a motion when it moves.
        apart: Metres by which a sequence may differ from what it would be alone.
        model: What the weights have otherwise than the usual tiny ones.
    """

    key: str
    write: Callable[..., Path]
    options: Mapping[str, str]
    condition: Condition
    passes: int
    moved: tuple[str, ...] = ("goal", "initial_joints", "previous_joints")
    apart: float = 1e-4
    model: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    fps: float = 20.0

    @property
    def name(self) -> str:
        return self.key.split("-")[0]

    @property
    def weights(self) -> Path:
        """The file, written once a run."""
        folder = made_once(f"weights-{self.key}", lambda path: self.write(path / "tiny.safetensors", **self.model))
        return folder / "tiny.safetensors"

    def batch(self, *frames: int) -> ConditionBatch:
        """As many sequences as lengths are given."""
        lengths = frames or (11, 9)
        if self.condition is Condition.TEXT:
            return denoisers.text_batch(list(lengths))
        return dataclasses.replace(conditions(self.condition, len(lengths), frames=lengths), fps=self.fps)

    def load(self, weights: Path | None = None, **options: str) -> Any:
        """The method with its tiny weights, or others."""
        given = {**self.options, **{key.replace("_", "-"): value for key, value in options.items()}}
        return load_adapter(self.name, weights or self.weights, given, "cpu")

    def generate(self, batch: ConditionBatch, **options: str) -> Motions:
        """Generate with the tiny weights."""
        return self.load(**options).generate(batch, seed=0)


_DDIM = {"sampler": "ddim", "steps": "2"}
_SAMPLED = {"optimise": "off"}
_QUICK = {"iterations": "3", "ddim-steps": "2"}
_TWICE = {"iterations": "2"}
_TO_PLACE = {"goal": "location"}
_ALL = ("goal", "text", "initial_joints", "previous_joints")
_TWO_STEPS = {"diffusion_steps": 2}
METHODS = {
    each.key: each
    for each in (
        Method("mdm", denoisers.write, _DDIM, Condition.TEXT, 2 * 2 * 2, ("text",)),
        Method("pr", denoisers.write, _SAMPLED, LOCATION, 2 * 8, _ALL, model=_TO_PLACE),
        Method("pr-pose", denoisers.write, _SAMPLED, POSE, 2 * 8, model={"goal": "pose"}),
        Method("pr-optimised", denoisers.write, _QUICK, LOCATION, 2 * 4 * 2, apart=1e-3, model=_TO_PLACE),
        Method("dno", denoisers.write, _QUICK, LOCATION, 2 * 4 * 2, ("initial_joints",), 3e-3),
        Method("dno-pose", denoisers.write, _QUICK, POSE, 2 * 4 * 2, ("goal",), 3e-3),
        # Three roll-outs of two primitives and of one: two guided steps and a decoding each.
        Method("dart", dart.write, {"iterations": "2"}, LOCATION, 3 * (2 + 1) * (2 * 2 + 1), _ALL, model=_TWO_STEPS),
        Method(
            "dart-pose", dart.write, {"iterations": "2"}, POSE, 3 * (2 + 1) * (2 * 2 + 1), ("goal",), model=_TWO_STEPS
        ),
        Method("gmd", gmd.write, {"steps": "5"}, POSE, 2 * 2 * 5 * 2, ("goal",), 1e-3),
        Method("wandr", wandr.write, {}, LOCATION, 10 + 8, apart=1e-6, fps=30.0),
    )
}
GOALS = [key for key in METHODS if key != "mdm"]


@pytest.fixture(params=METHODS.values(), ids=METHODS.keys())
def method(request: pytest.FixtureRequest) -> Method:
    return request.param


def _largest_change(first: Motions, second: Motions) -> float:
    return float(np.abs(first.ragged() - second.ragged()).max())


def test_motions_are_as_long_as_asked_and_their_passes_are_declared(method):
    adapter, batch = method.load(), method.batch()
    assert isinstance(adapter, Adapter)
    assert method.condition in adapter.conditions
    assert adapter.native_fps == method.fps
    assert adapter.weights_for(method.condition) == method.weights
    motions = adapter.generate(batch, seed=0)
    assert (motions.joints.shape, motions.joints.dtype) == ((2, 11, 22, 3), np.float32)
    assert motions.n_frames.tolist() == [11, 9]
    assert np.isfinite(motions.ragged()).all()
    assert motions.cost is not None
    assert motions.cost.network_passes == method.passes
    if method.name in ("dart", "wandr"):
        assert np.array_equal(motions.joints[:, 0], batch.initial_joints)


@pytest.mark.parametrize(
    ("key", "options", "passes"),
    [
        ("mdm", {"guidance": "1"}, 2 * 2),
        ("dno", {"guidance": "2.5"}, 2 * 2 * 4 * 2),
        ("gmd", {"guidance": "1"}, 2 * 2 * 5),
        ("dart", {"guidance": "1"}, 3 * (2 + 1) * (2 * 1 + 1)),
        ("dart", {"ddim_steps": "1"}, 3 * (2 + 1) * (2 * 1 + 1)),
    ],
)
def test_guidance_and_steps_decide_the_passes(key, options, passes):
    cost = METHODS[key].generate(METHODS[key].batch(), **options).cost
    assert cost is not None
    assert cost.network_passes == passes


def test_the_seed_of_a_sequence_decides_its_motion_and_the_batch_around_it_nothing(method):
    # Where motions differ by more than rounding, that may decide whether a foot takes a step.
    adapter = method.load(**({"feet": "predicted"} if method.apart > 1e-4 else {}))
    batch = method.batch(17, 11, 40, 9, 16)
    together = adapter.generate(batch, seed=0)
    assert np.array_equal(adapter.generate(batch, seed=9).joints, together.joints), "the run's seed is recorded only"
    for row, n in enumerate(batch.n_frames):
        alone = adapter.generate(batch.rows(row, row + 1), seed=0).joints[0]
        np.testing.assert_allclose(alone[:n], together.joints[row, :n], rtol=0, atol=method.apart)
    other = adapter.generate(dataclasses.replace(batch, noise_seed=(5, 6, 7, 8, 9)), seed=0)
    assert _largest_change(other, together) > 1e-3


def _moved(batch: ConditionBatch, what: str) -> ConditionBatch:
    if what == "text":
        return dataclasses.replace(batch, text=("sits down",) * len(batch))
    if what == "goal":
        what = "goal_location" if batch.goal_location is not None else "goal_joints"
    return dataclasses.replace(batch, **{what: getattr(batch, what) + np.float32([0.2, 0.0, 0.1])})


@pytest.mark.parametrize(("key", "what"), [(each.key, what) for each in METHODS.values() for what in each.moved])
def test_a_motion_depends_on_its_conditions(key, what):
    batch = METHODS[key].batch()
    assert _largest_change(METHODS[key].generate(batch), METHODS[key].generate(_moved(batch, what))) > 1e-4


@pytest.mark.parametrize(
    ("key", "what", "options"),
    [
        ("dart", "goal", {"optimise": "off"}),
        ("dno", "text", {}),
        ("dno", "previous_joints", {}),
        ("wandr", "text", {}),
    ],
)
def test_what_a_method_does_not_look_at_changes_nothing(key, what, options):
    batch, given = METHODS[key].batch(), {} if options else METHODS[key].options
    adapter = load_adapter(METHODS[key].name, METHODS[key].weights, {**given, **options}, "cpu")
    first, second = (adapter.generate(each, seed=0).joints for each in (batch, _moved(batch, what)))
    assert np.array_equal(first, second)


@pytest.mark.parametrize("value", [np.nan, 40.0])
@pytest.mark.parametrize("key", GOALS)
def test_a_goal_out_of_any_reach_is_refused_with_its_row(key, value):
    batch = METHODS[key].batch()
    name = "goal_location" if batch.goal_location is not None else "goal_joints"
    goals = getattr(batch, name).copy()
    goals[1, ..., 2] = value
    told = rf"adapter '{METHODS[key].name}', row 1 of the batch .*: expected a goal within 10 m of the first pose"
    with pytest.raises(AdapterError, match=told):
        METHODS[key].generate(dataclasses.replace(batch, **{name: goals}))


def test_goals_above_any_hand_and_poses_with_one_lost_joint_are_refused():
    place, pose = METHODS["pr"].batch(), METHODS["pr-pose"].batch()
    assert place.goal_location is not None
    place.goal_location[1, 1] = 4.0
    with pytest.raises(AdapterError, match=r"row 1 of the batch .* and 3 m of the floor"):
        METHODS["pr"].generate(place)
    assert pose.goal_joints is not None
    pose.goal_joints[1, 21, 0] = np.nan
    with pytest.raises(AdapterError, match="row 1"):
        METHODS["pr-pose"].generate(pose)


@pytest.mark.parametrize(("key", "most"), [("mdm", 40), ("pr", 40), ("pr-optimised", 40), ("dno", 40), ("gmd", 60)])
def test_longer_sequences_than_the_model_knows_are_refused(key, most):
    assert METHODS[key].load().max_frames == most
    with pytest.raises(AdapterError, match=f"at most {most} frames, and was asked for {most + 1}"):
        METHODS[key].generate(METHODS[key].batch(9, most + 1))


@pytest.mark.parametrize(("key", "other"), [("dart", 30.0), ("wandr", 20.0)])
def test_another_frame_rate_is_refused(key, other):
    with pytest.raises(AdapterError, match=f"expected {METHODS[key].fps:g} frames per second, found {other:g}"):
        METHODS[key].generate(dataclasses.replace(METHODS[key].batch(), fps=other))


@pytest.mark.parametrize(
    ("key", "options", "message"),
    [
        ("mdm", {"guidence": "2"}, r"unknown option 'guidence'. Did you mean 'guidance'\?"),
        ("mdm", {"steps": "9"}, "option 'steps': expected a whole number from 1 to 8, found '9'"),
        ("mdm", {"sampler": "heun"}, "option 'sampler'"),
        ("dno", {"optimise": "slow"}, "optimise"),
        ("dno", {"hand": "both"}, "hand"),
        ("dno", {"promt": "x"}, "promt"),
        ("dno", {"guidance": "-1"}, "guidance"),
        ("dno", {"alpha": "1"}, "alpha"),
        ("dart", {"optimise": "slow"}, "optimise"),
        ("dart", {"iterations": "0"}, "iterations"),
        ("dart", {"hand": "both"}, "hand"),
        ("dart", {"iteration": "3"}, "iteration"),
        ("dart", {"optimise": "off", "hand": "left"}, "'iterations' belongs to noise optimisation"),
        ("gmd", {"keyframe": "pose"}, r"unknown option 'keyframe'. Did you mean 'keyframes'\?"),
        ("gmd", {"keyframes": "both"}, "option 'keyframes': expected root or pose, found 'both'"),
        ("gmd", {"goal_scale": "-1"}, "option 'goal-scale': expected a number of 0 or more, found '-1'"),
        ("gmd", {"steps": "51"}, "option 'steps': expected a whole number from 1 to 50, found '51'"),
        ("wandr", {"hands": "left"}, "unknown option 'hands'. Did you mean 'hand'"),
        ("wandr", {"hand": "both"}, "expected right or nearest or left, found 'both'"),
        ("wandr", {"most_speed": "fast"}, "option 'most-speed': expected a number of 0 or more"),
        ("pr", {"guidence": "2"}, "unknown option 'guidence'. Did you mean 'guidance'"),
        ("pr", {"hand": "left"}, "'hand' belongs to noise optimisation"),
        ("pr", {"noise_scale": "-1"}, "option 'noise-scale': expected a number of 0 or more, found '-1'"),
        ("pr", {"sampler": "heun"}, "expected ddpm or ddim or one-pass, found 'heun'"),
        ("pr", {"steps": "9"}, "from 1 to 8, found '9'"),
        ("pr", {"optimise": "slow"}, "option 'optimise': expected"),
        ("pr-optimised", {"sampler": "ddim"}, "'sampler' belongs to sampling without noise optimisation"),
        ("pr-optimised", {"steps": "5"}, "'steps' belongs to sampling without noise optimisation"),
        ("pr-optimised", {"noise_scale": "2"}, "'noise-scale' belongs to sampling without noise optimisation"),
        ("pr-optimised", {"hand": "both"}, "option 'hand': expected"),
        ("pr", {"reach": "goal"}, "option 'reach'.* expected a model of goal-frame features"),
        ("pr", {"smooth": "predicted"}, "option 'smooth'.* expected a model of goal-frame features"),
        ("pr", {"feet": "glide"}, "option 'feet': expected steps or predicted, found 'glide'"),
    ],
)
def test_options_that_make_no_sense_are_refused(key, options, message):
    with pytest.raises((ValueError, AdapterError), match=message):
        METHODS[key].load(**options)


@pytest.mark.parametrize(
    ("key", "model", "error", "message"),
    [
        ("mdm", {"goal": "location"}, AdapterError, "expected a model of goal 'none', found one of goal 'loc"),
        ("dno", {"goal": "location"}, AdapterError, "goal"),
        ("pr", {}, AdapterError, "expected a model of goal location or pose, found one of goal 'none'"),
        (
            "pr",
            {"goal": "location", "metadata": {"representation": "rotations-135/continuous"}},
            InputFileError,
            r"'humanml3d-263/continuous'.*'rotations-135/continuous'",
        ),
        ("gmd", {"metadata": {"kind": "denoiser"}}, InputFileError, "'kind': expected 'gmd', found 'denoiser'"),
        (
            "gmd",
            {"metadata": {"configuration": '{"motion_widths":[16,16],"trajectory_widths":[8,8],"text_dimension":64}'}},
            InputFileError,
            r"networks\.motion\..*: expected shape",
        ),
        ("dart", {"latent_std": 0.0}, InputFileError, r"latent.std: expected a positive number, found 0.*stopped"),
        ("wandr", {"metadata": {"kind": "denoiser"}}, InputFileError, "header entry 'kind': expected 'wandr'"),
    ],
)
def test_weights_of_another_model_are_refused(key, model, error, message, tmp_path):
    with pytest.raises(error, match=message):
        METHODS[key].load(METHODS[key].write(tmp_path / "other.safetensors", **model))


@pytest.mark.parametrize("key", ["gmd", "dart", "wandr"])
def test_a_version_without_weights_says_how_to_get_some(key, tmp_path, monkeypatch):
    monkeypatch.setattr(bundles, "files", lambda package: tmp_path)
    folder = tmp_path / key / "weights"
    folder.mkdir(parents=True)
    told = f"{key}: no weights come with .*`prbench train --method {key} --config small"
    with pytest.raises(AdapterError, match=told):
        load_adapter(key, None, {}, "cpu")
    small = METHODS[key].write(folder / f"{key}-small.safetensors")
    assert load_adapter(key, None, {}, "cpu").weights_for(METHODS[key].condition) == small


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
@pytest.mark.parametrize("key", ["mdm", "gmd", "dart", "wandr"])
def test_a_missing_gpu_is_said_so(key):
    with pytest.raises(AdapterError, match="there is no usable GPU here"):
        load_adapter(key, METHODS[key].weights, {}, "cuda")


@pytest.mark.parametrize("key", ["pr", "pr-optimised", "dno", "dart", "gmd"])
def test_bones_keep_the_lengths_of_the_initial_pose_if_asked(key):
    batch = METHODS[key].batch()
    assert batch.initial_joints is not None
    wanted = bone_lengths(batch.initial_joints)
    lengths = {way: METHODS[key].generate(batch, bones=way) for way in ("predicted", "initial")}
    for row, n in enumerate(batch.n_frames):
        own, others = (bone_lengths(lengths[way].joints[row, :n]) for way in ("initial", "predicted"))
        np.testing.assert_allclose(own, np.tile(wanted[row], (n, 1)), rtol=1e-4)
        assert not np.allclose(others, wanted[row], rtol=0.05)


@pytest.mark.parametrize("key", ["mdm", "pr", "dno", "dart", "gmd"])
def test_a_model_of_one_skeleton_moves_bodies_of_their_own_size(key, tmp_path):
    """Conditions are put on the model's skeleton and the motion is scaled back.

    Source: docs/specification/pr-model.md#data-and-features.
    """
    method = METHODS[key]
    uniform = method.write(tmp_path / "uniform.safetensors", uniform_skeleton=True, **method.model)
    # Feet that step depend on the size.
    alone = {"bones": "predicted", "feet": "predicted"}
    adapter, batch = method.load(uniform, **alone), method.batch()
    bodies = ModelBodies.of(batch, _configuration(adapter))
    inside = method.generate(bodies.batch, **alone).joints
    own = bodies.own(inside)
    assert key == "mdm" or np.abs(own - inside).max() > 1e-3
    np.testing.assert_allclose(adapter.generate(batch, seed=0).joints, own, atol=1e-4)


def _configuration(adapter: Any) -> Any:
    models = getattr(adapter, "models", None)
    return (next(iter(models.values())).model if models else adapter.model).configuration
