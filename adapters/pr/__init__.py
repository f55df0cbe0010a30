"""P&R: motions that look at a goal and reach it, by diffusion with initial state and goal as conditions.

The study's own method (*Prime and Reach*, section 4; docs/specification/pr-model.md): one model for goal poses, one for
object locations, and an optimisation of the starting noise towards initial pose and goal. torch is imported on first
use.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

from prbench.contract import Adapter, Condition, ConditionBatch, Motions
from prbench.errors import AdapterError
from prbench_adapters.diffusion.method import GOALS, IN_TRAINING, TEXT_GUIDANCE, TextSampler, require_goals_within_reach

if TYPE_CHECKING:
    from prbench_adapters.diffusion.configuration import DenoiserConfiguration
    from prbench_adapters.diffusion.generation import SamplingSettings
    from prbench_adapters.diffusion.model import MotionModel
    from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings
    from prbench_adapters.diffusion.tasks import DiffusionTask

DEFAULT_WEIGHTS = {Condition.GOAL_LOCATION: "pr-small-goal-loc", Condition.GOAL_POSE: "pr-small-goal-pose"}

_GUIDANCE = 1.0  # the conditional estimate alone (docs/specification/pr-model.md#sampling-without-optimisation)
_MODES = ("fast", "paper", "off")
_BONES = ("predicted", "initial")
_OBSTACLES = ("ignore", "avoid")


@dataclass(frozen=True)
class Generation:
    """Settings by which motions are made from conditions."""

    sampling: SamplingSettings
    """Without optimisation."""
    optimisation: OptimisationSettings | None
    """None for plain sampling."""
    own_bones: bool = False
    """Keep the bone lengths of the initial pose in sampled motions; an optimisation has its own setting."""
    avoids_obstacles: bool = False
    """Lead the finished motions around the scene's boxes."""


@dataclass(frozen=True)
class TrainedFor:
    """A model, the file that it came from, and how it generates."""

    model: MotionModel
    path: Path
    generation: Generation


class PR:
    """Generates motions towards a goal pose or an object location, with a model for each.

    Args:
        models: By condition; those of one file or one folder may serve one condition only.
    """

    name = "pr"
    conditions = frozenset(GOALS)

    def __init__(self, models: Mapping[Condition, TrainedFor]) -> None:
        self.models = dict(models)
        configurations = [trained.model.configuration for trained in self.models.values()]
        # One limit for the method: the harness asks for it before it knows the condition.
        self.max_frames = min(configuration.max_frames for configuration in configurations)
        self.native_fps = configurations[0].fps
        self.wants_obstacles = any(trained.generation.avoids_obstacles for trained in self.models.values())

    def weights_for(self, condition: Condition) -> Path:
        """The weights file that a condition uses.

        Raises:
            AdapterError: if the weights given are those of the other kind of goal.
        """
        return self._trained_for(condition).path

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Generate one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, weights of the other kind of goal, or boxes that are to be
                avoided and were not given.
        """
        trained = self._trained_for(batch.condition)
        require_goals_within_reach(batch, adapter=self.name)
        motions = self._made(trained, batch)
        if not trained.generation.avoids_obstacles:
            return motions
        from prbench_adapters.diffusion.obstacles import led_around

        return led_around(motions, batch)

    def _made(self, trained: TrainedFor, batch: ConditionBatch) -> Motions:
        generation = trained.generation
        if generation.optimisation is None:
            from prbench_adapters.diffusion.batches import on_own_bones
            from prbench_adapters.diffusion.generation import generate

            motions = generate(trained.model, batch, generation.sampling)
            return on_own_bones(motions, batch) if generation.own_bones else motions
        from prbench_adapters.diffusion.noise_optimisation.generation import generate_optimised

        return generate_optimised(trained.model, batch, generation.optimisation)

    def _trained_for(self, condition: Condition) -> TrainedFor:
        if condition in self.models:
            return self.models[condition]
        other, given = next(iter(self.models.items()))
        raise AdapterError(
            f"weights {given.path}: expected a model of goal '{GOALS[condition]}' for '{condition.value}', found one of"
            f" goal '{GOALS[other]}'. Choose other weights, or --condition {other.value}."
        )


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> PR:
    """Entry point ``pr``.

    Options: ``optimise`` (fast, paper or off), with ``hand`` (right, nearest, left) and the other
    ``PRIME_AND_REACH_OPTIONS`` of :mod:`prbench_adapters.diffusion.noise_optimisation.settings`; ``guidance`` (1),
    ``steps``; without optimisation also ``sampler`` (ddpm or ddim) and ``reach`` (predicted, or goal: a wrist is led to
    a goal location at the end); ``bones`` (predicted, or initial for the initial pose's lengths); ``obstacles``
    (ignore, or avoid: finished motions are led around the scene's boxes); ``text-path`` (files of the text encoder, if
    the weights need one that has some).

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
    from prbench_adapters.diffusion.bundled import resolve
    from prbench_adapters.diffusion.noise_optimisation.settings import PRIME_AND_REACH_OPTIONS
    from prbench_adapters.diffusion.options import SAMPLING_OPTIONS, require_known

    require_known(options, ("optimise", *SAMPLING_OPTIONS, "text-path", "reach", "obstacles", *PRIME_AND_REACH_OPTIONS))
    if weights is None:
        paths = {condition: resolve(None, name) for condition, name in DEFAULT_WEIGHTS.items()}
        models = {condition: _load(path, device, options, (condition,)) for condition, path in paths.items()}
    else:
        trained = _load(resolve(weights, ""), device, options, tuple(GOALS))
        goal = trained.model.configuration.goal
        models = {condition: trained for condition, kind in GOALS.items() if kind == goal}
    return PR(models)


def training_task() -> DiffusionTask:
    """Make the task of ``prbench train --method pr``: text, initial state and goal. Pre-training may be ``mdm``'s."""
    from prbench_adapters.diffusion.tasks import DiffusionTask

    goals = ("pose", "location")
    return DiffusionTask("pr", goals=goals, configurations="prbench_adapters.pr", validating=_in_training)


def _in_training(model: MotionModel) -> Adapter:
    """The method that a training is validated with: no noise optimisation, and in pre-training no goal."""
    from prbench_adapters.diffusion.generation import SamplingSettings

    goal = model.configuration.goal
    if goal == "none":
        return TextSampler(model, IN_TRAINING, SamplingSettings(guidance=TEXT_GUIDANCE))
    condition = next(key for key, kind in GOALS.items() if kind == goal)
    return PR({condition: TrainedFor(model, IN_TRAINING, Generation(SamplingSettings(guidance=_GUIDANCE), None))})


def _load(path: Path, device: str, options: Mapping[str, str], allowed: tuple[Condition, ...]) -> TrainedFor:
    from prbench_adapters.diffusion.model import MotionModel
    from prbench_adapters.diffusion.options import choice

    model = MotionModel.load(path, device, text_path=options.get("text-path"))
    wanted = [GOALS[condition] for condition in allowed]
    if model.configuration.goal not in wanted:
        raise AdapterError(
            f"weights {path}: expected a model of goal {' or '.join(wanted)}, found one of goal"
            f" '{model.configuration.goal}'. Choose weights that `prbench train --method pr --stage finetune` made."
        )
    if options.get("reach") == "goal" and model.configuration.features != "goal-frame":
        raise AdapterError(
            f"option 'reach': weights {path}: expected a model of goal-frame features, found one of"
            f" {model.configuration.features}. Leave the option out, or choose other weights."
        )
    avoids = choice(options, "obstacles", _OBSTACLES) == "avoid"
    return TrainedFor(model, path, replace(_generation(options, model.configuration), avoids_obstacles=avoids))


def _generation(options: Mapping[str, str], configuration: DenoiserConfiguration) -> Generation:
    """Turn the options into settings for a model, checked before anything is generated."""
    from prbench_adapters.diffusion.model import Reach
    from prbench_adapters.diffusion.noise_optimisation.settings import (
        PRIME_AND_REACH_OPTIONS,
        fast,
        finishing,
        optimisation_settings,
        paper,
    )
    from prbench_adapters.diffusion.options import SAMPLING_OPTIONS, choice, sampling_settings

    diffusion_steps = configuration.diffusion_steps
    sampling = sampling_settings(options, guidance=_GUIDANCE, diffusion_steps=diffusion_steps)
    mode = choice(options, "optimise", _MODES)
    if mode == "off":
        idle = [key for key in PRIME_AND_REACH_OPTIONS if key in options and key not in ("bones", *SAMPLING_OPTIONS)]
        if idle:
            raise ValueError(f"option '{idle[0]}' belongs to noise optimisation; choose optimise=fast or paper.")
        reach = cast(Reach, choice(options, "reach", get_args(Reach)))
        return Generation(replace(sampling, reach=reach), None, own_bones=choice(options, "bones", _BONES) == "initial")
    if "reach" in options:
        raise ValueError("option 'reach': noise optimisation reaches by itself; choose optimise=off.")
    # ddpm is also the default of plain sampling, so only a user's own word is refused.
    if sampling.sampler == "ddpm" and "sampler" in options:
        raise ValueError("option 'sampler': noise optimisation needs a fixed map from noise to motion, which is ddim.")
    if "steps" in options and "ddim-steps" in options:
        raise ValueError("options 'steps' and 'ddim-steps' mean the same in noise optimisation; give one of them.")
    quick = finishing if configuration.features == "goal-frame" else fast
    preset = {"fast": quick, "paper": paper}[mode](diffusion_steps)
    preset = replace(preset, guidance=sampling.guidance, ddim_steps=sampling.steps or preset.ddim_steps)
    return Generation(sampling, optimisation_settings(options, preset, diffusion_steps=diffusion_steps))
