"""P&R: motions that look at a goal and reach it, by diffusion with initial state and goal as conditions.

The study's own method (*Prime and Reach*, section 4; docs/specification/pr-model.md): one model for goal poses, one for
object locations, and an optimisation of the starting noise towards initial pose and goal. torch is imported on first
use.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.errors import AdapterError
from prbench_adapters.diffusion.method import GOALS, late, require_goals_within_reach, resolve

if TYPE_CHECKING:
    from prbench_adapters.diffusion.configuration import DenoiserConfiguration
    from prbench_adapters.diffusion.generation import SamplingSettings
    from prbench_adapters.diffusion.model import MotionModel
    from prbench_adapters.diffusion.noise_optimisation import OptimisationSettings
    from prbench_adapters.finishing import Finishing

DEFAULT_WEIGHTS = {Condition.GOAL_LOCATION: "pr-small-goal-loc", Condition.GOAL_POSE: "pr-small-goal-pose"}

_GUIDANCE = 1.0  # the conditional estimate alone (docs/specification/pr-model.md#sampling-without-optimisation)
_MODES = ("fast", "paper", "off")
_SAMPLING_ALONE = ("sampler", "steps", "noise-scale")
# Parts of decoding, and how they are constructed; ``predicted`` leaves one to the network. All but the bones belong to
# goal-frame features.
_CONSTRUCTED = {"bones": "initial", "first": "given", "smooth": "averaged", "reach": "goal"}


@dataclass(frozen=True)
class TrainedFor:
    """A model, the file that it came from, and how it generates.

    Attributes:
        settings: Settings of plain sampling, or of noise optimisation.
        finishing: What is done to the joints after the network; goal-frame features bring bones of their own.
    """

    model: MotionModel
    path: Path
    settings: SamplingSettings | OptimisationSettings
    finishing: Finishing


class PR:
    """Generates motions towards a goal pose or an object location, with a model for each.

    Args:
        models: Models by condition; those of one file or one folder may serve one condition only.
    """

    name = "pr"
    conditions = frozenset(GOALS)

    def __init__(self, models: Mapping[Condition, TrainedFor]) -> None:
        self.models = dict(models)
        configurations = [trained.model.configuration for trained in self.models.values()]
        # One limit for the method: the harness asks for it before it knows the condition.
        self.max_frames = min(configuration.max_frames for configuration in configurations)
        self.native_fps = configurations[0].fps

    def weights_for(self, condition: Condition) -> Path:
        """Return the weights file that a condition uses.

        Raises:
            AdapterError: if the weights given are those of the other kind of goal.
        """
        return self._trained_for(condition).path

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Generate one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, or weights of the other kind of goal.
        """
        trained = self._trained_for(batch.condition)
        require_goals_within_reach(batch, adapter=self.name)
        from prbench_adapters.diffusion.generation import SamplingSettings, generate
        from prbench_adapters.diffusion.optimised_generation import generate_optimised

        if isinstance(trained.settings, SamplingSettings):
            motions = generate(trained.model, batch, trained.settings)
        else:
            motions = generate_optimised(trained.model, batch, trained.settings)
        return trained.finishing(motions, batch)

    def _trained_for(self, condition: Condition) -> TrainedFor:
        if condition in self.models:
            return self.models[condition]
        other, given = next(iter(self.models.items()))
        problem = f"expected a model of goal '{GOALS[condition]}' for '{condition.value}',"
        found = f"found one of goal '{GOALS[other]}'. Choose other weights, or --condition {other.value}."
        raise AdapterError(f"weights {given.path}: {problem} {found}")


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> PR:
    """Entry point ``pr``.

    Options: ``optimise`` (fast, paper or off), with ``hand`` (right, nearest, left) and the other
    ``PRIME_AND_REACH_OPTIONS`` of :mod:`prbench_adapters.diffusion.noise_optimisation`; without optimisation
    ``sampler`` (ddpm, ddim, or one-pass for weights of few steps, which needs no ``optimise=off``), ``steps`` and
    ``noise-scale`` (1: deviation of the noise that sampling starts from; with 2 several motions for one goal differ
    more); ``guidance`` (1); ``text-path`` (files of the text encoder, if the weights need one that has some); and what
    is constructed, each of which ``predicted`` leaves to the network: ``bones`` (initial), ``feet`` (steps), and with
    goal-frame features ``first`` (given), ``smooth`` (averaged) and ``reach`` (goal: a wrist is led to a goal location
    at the end; the default with ``fast`` alone).

    Args:
        weights: File, folder or name of bundled weights, for one kind of goal; None for ``pr-small-goal-loc`` and
            ``pr-small-goal-pose``, whichever the condition asks for.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, no such weights, or they know no goal.
        InputFileError: if a file is not one of a denoiser.
        ValueError: for options that are unknown or have impossible values.
    """
    from prbench_adapters.diffusion.generation import SAMPLING_OPTIONS, require_known
    from prbench_adapters.diffusion.noise_optimisation import PRIME_AND_REACH_OPTIONS
    from prbench_adapters.finishing import FINISHING_OPTIONS

    own = ("optimise", "text-path", "noise-scale", *FINISHING_OPTIONS, *_CONSTRUCTED)
    require_known(options, (*own, *SAMPLING_OPTIONS, *PRIME_AND_REACH_OPTIONS))
    if weights is None:
        paths = {condition: resolve(None, name) for condition, name in DEFAULT_WEIGHTS.items()}
        models = {condition: _load(path, device, options, (condition,)) for condition, path in paths.items()}
    else:
        trained = _load(resolve(weights, ""), device, options, tuple(GOALS))
        goal = trained.model.configuration.goal
        models = {condition: trained for condition, kind in GOALS.items() if kind == goal}
    return PR(models)


def training_task() -> object:
    """Make the task of ``prbench train --method pr``: text, initial state and goal. Pre-training may be ``mdm``'s."""
    task = late("diffusion.training:DiffusionTask")
    return task("pr", goals=("pose", "location"), configurations="prbench_adapters.pr")


def _load(path: Path, device: str, options: Mapping[str, str], allowed: tuple[Condition, ...]) -> TrainedFor:
    from prbench_adapters.diffusion.generation import ONE_PASS
    from prbench_adapters.diffusion.model import MotionModel
    from prbench_adapters.diffusion.sampling import MOST_PASSES
    from prbench_adapters.finishing import Finishing

    model = MotionModel.load(path, device, text_path=options.get("text-path"))
    wanted = [GOALS[condition] for condition in allowed]
    if model.configuration.goal not in wanted:
        found = f"found one of goal '{model.configuration.goal}'."
        remedy = "Choose weights that `prbench train --method pr --stage finetune` made."
        raise AdapterError(f"weights {path}: expected a model of goal {' or '.join(wanted)}, {found} {remedy}")
    finishing = Finishing.of(options)
    if model.configuration.features == "goal-frame":
        finishing = replace(finishing, bones=False)
    else:
        idle = [key for key in ("first", "smooth") if key in options]
        if idle or options.get("reach") == "goal":
            found = f"found one of {model.configuration.features}. Leave the option out, or choose other weights."
            option = (*idle, "reach")[0]
            raise AdapterError(f"option '{option}': weights {path}: expected a model of goal-frame features, {found}")
    steps = model.configuration.diffusion_steps
    if options.get("sampler") == ONE_PASS and steps > MOST_PASSES:
        why = f"one-pass takes 1 to {MOST_PASSES} network passes, but weights {path} need {steps}."
        advice = f"Train some with --set model.diffusion_steps={MOST_PASSES}, or choose optimise=off."
        raise AdapterError(f"option 'sampler': {why} {advice}")
    return TrainedFor(model, path, _settings(options, model.configuration), finishing)


def _settings(
    options: Mapping[str, str], configuration: DenoiserConfiguration
) -> SamplingSettings | OptimisationSettings:
    """Turn the options into settings for a model."""
    from prbench_adapters.diffusion import noise_optimisation as noise
    from prbench_adapters.diffusion.generation import ONE_PASS, SAMPLERS, choice, number, sampling_settings
    from prbench_adapters.diffusion.goal_frame import TRAINED_WITH

    steps = configuration.diffusion_steps
    if options.get("sampler") == ONE_PASS:
        # All steps of the weights and no optimisation; an option that would add passes or leave some out is a mistake.
        for key, idle in (("optimise", "off"), ("guidance", "1"), ("steps", None)):
            if key in options and options[key] != idle:
                remedy = "leave it out."
                raise ValueError(f"option '{key}': sampler=one-pass takes the passes of the weights alone; {remedy}")
        options = {**options, "optimise": "off"}
    mode = choice(options, "optimise", _MODES)
    parts = TRAINED_WITH
    for part, value in _CONSTRUCTED.items():
        usual = value if part in parts else "predicted"
        chosen = choice(options, part, (value, "predicted"), usual)
        parts = parts - {part} if chosen == "predicted" else parts | {part}
    if mode == "off":
        idle = [key for key in noise.PRIME_AND_REACH_OPTIONS if key in options and key not in _CONSTRUCTED]
        if idle:
            raise ValueError(f"option '{idle[0]}' belongs to noise optimisation; choose optimise=fast or paper.")
        sampling = sampling_settings(options, guidance=_GUIDANCE, diffusion_steps=steps, samplers=(*SAMPLERS, ONE_PASS))
        return replace(sampling, parts=parts, noise_scale=number(options, "noise-scale", 1.0))
    idle = [key for key in _SAMPLING_ALONE if key in options]
    if idle:
        remedy = "choose optimise=off, or leave it out."
        raise ValueError(f"option '{idle[0]}' belongs to sampling without noise optimisation; {remedy}")
    quick = noise.finishing if configuration.features == "goal-frame" else noise.fast
    preset = {"fast": quick, "paper": noise.paper}[mode](steps)
    preset = replace(preset, guidance=number(options, "guidance", _GUIDANCE), parts=parts - {"reach"})
    return noise.optimisation_settings(options, preset, diffusion_steps=steps)
