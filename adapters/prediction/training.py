"""Training of the predictors: windows turned about the vertical and mirrored, losses, and the task of each method."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from prbench.errors import UsageError
from prbench.randomness import named_generator
from prbench_adapters.prediction import records
from prbench_adapters.prediction.belfusion import BehaviourConfiguration, UNetConfiguration
from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion, held
from prbench_adapters.prediction.configuration import PRESETS, DiffusionConfiguration, preset
from prbench_adapters.prediction.gazemotion import GazeMotionConfiguration
from prbench_adapters.prediction.recurrent import CVAEConfiguration, DLow, DLowConfiguration, Losses
from prbench_adapters.training.batches import WindowBatch, WindowChoice, WindowsDataset
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.task import TrainingModule, converted, split_model_table
from prbench_adapters.training.weights import Weights, origin_of, read_weights, start_from, weights_header
from prbench_benchmarks.motion_prediction.batch import Condition

# Whole windows: joints in metres, and the direction as the last node if there is one.
Motion = Float[Tensor, "windows frames nodes 3"]
_VALIDATION_SAMPLES = 5
_TOGETHER = 64
_MOST_WINDOWS = 4096  # Windows that statistics are taken from, spread evenly over the training split.
_SIDES = (("left", "right"), ("right", "left"), ("l", "r"), ("r", "l"))


def mirror_partners(names: Sequence[str]) -> tuple[int, ...]:
    """Index of the joint that each one becomes in a mirror: itself, unless it has a partner on the other side.

    Args:
        names: Joint names that begin with their side: ``left_hip``, ``right_hip``, or ``lHip``, ``rHip``.

    Raises:
        ValueError: if a name tells its side, and its partner is missing.
    """
    place = {name: index for index, name in enumerate(names)}
    partners = []
    for index, name in enumerate(names):
        others = [there + name.removeprefix(here) for here, there in _SIDES if name.startswith(here)]
        found = [place[other] for other in others if other in place]
        if not found and name.startswith(("left", "right")):
            raise ValueError(f"joint '{name}' has no partner on the other side among {', '.join(names)}")
        partners.append(found[0] if found else index)
    return tuple(partners)


def augmented(
    motion: Motion, partners: Sequence[int], *, turn: Float[Tensor, " windows"], mirrored: Bool[Tensor, " windows"]
) -> Motion:
    """Windows as they would have been seen turned, or in a mirror.

    Args:
        motion: Metres, Y up; nodes behind the joints are directions, which turn with the body.
        partners: :func:`mirror_partners` of the joints.
        turn: Angle about +Y through the origin, radians; 0 in the frame of the last pose, which has one heading.
        mirrored: Which windows are mirrored at the plane x = 0 before they are turned; left and right joints are
            exchanged, so that the body in the mirror has its labels right.
    """
    flipped = motion[:, :, [*partners, *range(len(partners), motion.shape[2])]] * motion.new_tensor([-1.0, 1.0, 1.0])
    motion = torch.where(mirrored[:, None, None, None], flipped, motion)
    cosine, sine = turn.cos()[:, None, None], turn.sin()[:, None, None]
    x, y, z = motion.unbind(-1)
    return torch.stack([cosine * x + sine * z, y, cosine * z - sine * x], dim=-1)


def _augmented_alike(motion: Motion, generator: torch.Generator) -> Motion:
    """Turn a whole batch about the vertical, negate x, and negate z, each with p = ½; labels of sides stay."""
    turned, *negated = (torch.rand(3, generator=generator) < 0.5).tolist()
    angle = 2.0 * math.pi * float(torch.rand(1, generator=generator)) * turned
    nobody = torch.zeros(len(motion), dtype=torch.bool, device=motion.device)
    motion = augmented(motion, range(motion.shape[2]), turn=motion.new_full((len(motion),), angle), mirrored=nobody)
    return motion * motion.new_tensor([1.0 - 2.0 * negated[0], 1.0, 1.0 - 2.0 * negated[1]])


class RateCourse(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``[model.rate]``: the published courses of the learning rate, on top of ``training.schedule``.

    Attributes:
        milestones: Shares of the training after which the rate is multiplied by ``factor``.
        linear_from: Share of the training after which the rate falls linearly to almost 0.
        exponential_to: Factor that the rate has fallen to at the end, by the same share in every step.
        encoder_apart: GazeMoDiff's encoder has an optimiser of its own, as in the public program: its rate keeps its
            height, and its weights are not averaged.

    Raises:
        ValueError: for places outside of the training.
    """

    milestones: tuple[float, ...] = ()
    factor: float = 0.9
    linear_from: float = 1.0
    exponential_to: float = 1.0
    encoder_apart: bool = False

    def __post_init__(self) -> None:
        require_within(self, "above 0", "exponential_to")
        if not all(0 < place < 1 for place in self.milestones) or not 0 <= self.linear_from <= 1 or self.factor <= 0:
            raise ValueError("'milestones' and 'linear_from' must lie between 0 and 1, and 'factor' above 0")

    def at(self, progress: float) -> float:
        """Factor on the learning rate after a share of the training, which is below 1."""
        factor = self.exponential_to**progress * self.factor ** sum(progress >= place for place in self.milestones)
        if progress > self.linear_from:
            factor *= (1.0 - progress) / (1.0 - self.linear_from)
        return factor


class PredictorTraining(TrainingModule):
    """A network with its losses.

    Args:
        kind: Kind of the weights file.
        record: What the header of the weights file says.
        network: The network in its state before the first step.
        losses: Returns the losses of whole windows by name, given this module, the windows, a generator and the step.
        course: Course of the learning rate.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        kind: str,
        record: records.Record,
        network: nn.Module,
        losses: Callable[[PredictorTraining, Motion, torch.Generator, int], Losses],
        course: RateCourse,
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.kind = kind
        self.record = record
        self.network: Any = network
        self.losses = losses
        self.course = course
        self.origin = origin
        self.augmentation = "mirror"
        self._partners = mirror_partners(record.windows.joints.names)

    def forward(self, batch: WindowBatch, step: int) -> Losses:  # pyright: ignore[reportIncompatibleMethodOverride]  # fed with windows
        """Return the losses of one batch, and in validation errors of drawn futures.

        Returns:
            ``loss`` and its parts; for negative steps also ``ade`` and ``fde``, metres over the flattened pose as the
            protocol has them, of the best of five futures (DLow: of its K), and ``still_ade`` of a body that stands
            still.
        """
        generator = self.generator(step)
        motion = self.shown(batch)
        if step < 0:
            return self.losses(self, motion, generator, step) | self._errors(motion, step)
        if self.augmentation != "mirror":
            shown = _augmented_alike(motion, generator) if self.augmentation == "published" else motion
            return self.losses(self, shown, generator, step)
        count = len(motion)
        mirrored = torch.rand(count, generator=generator) < 0.5
        turn = 2.0 * math.pi * torch.rand(count, generator=generator)
        if self.record.windows.frame == "last-pose":
            turn = torch.zeros(count)  # every body faces the same way
        motion = augmented(motion, self._partners, turn=turn.to(motion), mirrored=mirrored.to(motion.device))
        return self.losses(self, motion, generator, step)

    @torch.no_grad()
    def _errors(self, motion: Motion, step: int) -> Losses:
        """Errors of drawn futures of the joints."""
        network = self.network
        if not isinstance(network, records.PredictorNetwork):
            return {}
        seen = self.record.windows
        samples = network.configuration.n_samples if isinstance(network, DLow) else _VALIDATION_SAMPLES
        generator = named_generator("prbench-validation-futures", self.seed, step)
        seeds = generator.integers(2**63 - 1, size=(len(motion), samples)).tolist()
        observed, future = motion.split([seen.observed, seen.predicted], dim=1)
        wanted = future[:, None, :, : seen.n_joints].flatten(3)
        predicted = network.predict(observed, seeds)[:, :, :, : seen.n_joints].flatten(3)
        apart = (predicted - wanted).norm(dim=-1)
        still = (observed[:, -1:, : seen.n_joints].flatten(2) - wanted[:, 0]).norm(dim=-1)
        ade = apart.mean(dim=-1).amin(dim=1).mean()
        return {"ade": ade, "fde": apart[:, :, -1].amin(dim=1).mean(), "still_ade": still.mean()}

    def shown(self, batch: WindowBatch) -> Motion:
        """Return the windows of a batch, with directions that were not measured replaced by measured ones."""
        if batch.direction_valid is None:
            return batch.motion
        observed = self.record.windows.observed
        return torch.cat([held(batch.motion[:, :observed], batch.direction_valid), batch.motion[:, observed:]], dim=1)

    def weights(self) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return the network, frozen parts with it, and the header of its file."""
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        return tensors, weights_header(self.kind, self.record, f"windows/{self.record.windows.joint_set}")

    def learning_rate_factor(self, step: int) -> float:
        """Follow the course."""
        return self.course.at(step / self.calls)

    def apart(self) -> tuple[nn.Parameter, ...]:
        """Return the encoder's parameters where it has an optimiser of its own."""
        encoder = getattr(self.network, "encoder", None) if self.course.encoder_apart else None
        return () if encoder is None else tuple(encoder.parameters())

    def hidden_matrices(self) -> tuple[nn.Parameter, ...]:
        """Return the matrices of the blocks of a denoiser of coefficients."""
        if not isinstance(self.network, CoefficientDiffusion):
            return ()
        return tuple(each for each in self.network.denoiser.blocks.parameters() if each.ndim == 2)

    def spread(self, data: WindowsDataset) -> Iterator[Motion]:
        """Yield windows of the training split, spread over it, each followed by its mirror."""
        places = data.spread(-(-_MOST_WINDOWS // len(data.tables)))
        for first in range(0, len(places), _TOGETHER):
            motion = self.shown(data.collate([data[place] for place in places[first : first + _TOGETHER]]))
            yield motion
            everywhere = torch.ones(len(motion), dtype=torch.bool, device=motion.device)
            yield augmented(motion, self._partners, turn=motion.new_zeros(len(motion)), mirrored=everywhere)


def _normal(generator: torch.Generator, like: Tensor, *shape: int) -> Tensor:
    return torch.randn(shape, generator=generator).to(like)


def diffusion_losses(module: PredictorTraining, motion: Motion, generator: torch.Generator, step: int) -> Losses:  # noqa: ARG001
    """GazeMoDiff and HumanMAC: error of the noise at a random step of each window; 0 is never drawn, as published."""
    shape = module.network.configuration
    count = len(motion)
    index = torch.randint(1, shape.diffusion_steps, (count,), generator=generator).to(motion.device)
    kept = (torch.rand(count, generator=generator) < shape.condition_kept).to(motion.device)
    noise = _normal(generator, motion, count, shape.coefficients, shape.values)
    return {"loss": module.network.loss(motion, index, noise, kept)}


def latent_losses(module: PredictorTraining, motion: Motion, generator: torch.Generator, step: int) -> Losses:  # noqa: ARG001
    """CVAE and DLow: the losses of the futures of one noise vector a window."""
    observed = module.record.windows.observed
    cvae = module.network.cvae if isinstance(module.network, DLow) else module.network
    noise = _normal(generator, motion, len(motion), cvae.configuration.latent)
    return module.network.loss(motion[:, :observed], motion[:, observed:], noise)


def motion_losses(module: PredictorTraining, motion: Motion, generator: torch.Generator, step: int) -> Losses:  # noqa: ARG001
    """GazeMotion: the errors of its one future, and of the forecast of gaze."""
    return module.network.loss(motion)


def autoencoder_losses(
    module: PredictorTraining, motion: Motion, generator: torch.Generator, step: int, *, frozen_from: float
) -> Losses:
    """BeLFusion's autoencoders together: they share no parameter, so that one loss trains both.

    Args:
        module: The networks.
        motion: Whole windows.
        generator: Generator of the noise.
        step: Number of the step.
        frozen_from: Share of the training after which the coupler alone learns of the behaviour's networks.
    """
    shape = module.network.configuration
    past = module.network.past.loss(motion[:, : shape.observed])
    noise = _normal(generator, motion, len(motion), shape.behaviour)
    sequence = motion[:, shape.observed - shape.context :]
    found = module.network.behaviour.loss(sequence, noise, coupler_alone=step >= frozen_from * module.calls)
    return found | {"loss": past + found["loss"], "past": past}


def belfusion_losses(
    module: PredictorTraining, motion: Motion, generator: torch.Generator, step: int, *, noises: int
) -> Losses:
    """BeLFusion's diffusion of behaviours: errors of the best of some noises at one step for each window."""
    del step
    size = module.network.configuration.behaviour
    count = len(motion)
    index = torch.randint(len(module.network.schedule), (count,), generator=generator).to(motion.device)
    noise = _normal(generator, motion, count, noises, size)
    loss = module.network.loss(motion, index, noise, _normal(generator, motion, count, size))
    return {name: values.mean() for name, values in loss.items()}


class Phases(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of BeLFusion's autoencoders beside their sizes.

    Attributes:
        frozen_from: Share of the training after which the coupler alone learns.
    """

    frozen_from: float = 0.5


class BestOfNoises(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of BeLFusion's diffusion beside the sizes of the U-Net.

    Attributes:
        noises: Noises that are tried for each window, of which the best one counts.
        decoded_weight: Weight of the decoded future beside the behaviour.
    """

    noises: int = 50
    decoded_weight: float = 5.0


@dataclass(frozen=True)
class PredictorTask:
    """A training task that is fed windows (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name: str
    stages: tuple[str, ...] = ("train",)
    configurations: str = "prbench_adapters.prediction"

    def items(self, tables: Sequence[Any], split: str, model: Mapping[str, Any], seed: int) -> WindowsDataset:
        """Return the windows that ``[model.windows]`` chooses of some folders or tables.

        Raises:
            UsageError: for an unknown key or an impossible value.
        """
        choice = converted(model.get("windows", {}), WindowChoice, "model.windows")
        return WindowsDataset(tables, split=split, choice=choice, seed=seed)

    def build(
        self, model: Mapping[str, Any], *, data: WindowsDataset, initial: Path | None, stage: str
    ) -> PredictorTraining:
        """Make the network in its state before the first step.

        Args:
            model: Sizes; ``windows`` and ``rate`` are tables of their own.
            data: The training split, from which joints, rate and length come.
            initial: Weights to start from; DLow needs a CVAE, BeLFusion's diffusion its autoencoders.
            stage: One of ``stages``.

        Raises:
            UsageError: if the table does not describe such a network.
            InputFileError: if the initial weights do not fit it.
        """
        module = self._module(model, data=data, initial=initial, stage=stage)
        module.augmentation = data.choice.augmentation
        return module

    def _module(
        self, model: Mapping[str, Any], *, data: WindowsDataset, initial: Path | None, stage: str
    ) -> PredictorTraining:
        """Make the module with the losses of the method."""
        course = converted(model.get("rate", {}), RateCourse, "model.rate")
        sizes = {key: value for key, value in model.items() if key not in ("windows", "rate")}
        seen = data.shape
        if self.name == "dlow":
            start, old = _started("dlow", initial, seen, "a trained CVAE", "cvae")
            shape = converted(sizes, DLowConfiguration, "model")
            record = records.DLowRecord(windows=seen, network=shape, cvae=old.network)
            sampler = record.build()
            start.load_into(sampler.cvae, "network")
            return PredictorTraining("dlow", record, sampler, latent_losses, course, origin_of(start))
        if self.name == "belfusion" and stage == "autoencoders":
            own = {"n_joints": seen.nodes, "observed": seen.observed, "predicted": seen.predicted}
            network, phases = split_model_table({**sizes, **own}, BehaviourConfiguration, Phases)
            record = records.AutoencodersRecord(windows=seen, network=network)
            losses = partial(autoencoder_losses, frozen_from=phases.frozen_from)
            return PredictorTraining(records.AUTOENCODERS, record, record.build(), losses, course)
        if self.name == "belfusion":
            return _belfusion(sizes, seen, course, initial, data)
        losses = diffusion_losses
        if self.name == "cvae":  # a direction counts as one more joint
            own = {"n_joints": seen.nodes, "predicted": seen.predicted}
            record = records.CVAERecord(windows=seen, network=converted({**sizes, **own}, CVAEConfiguration, "model"))
            losses = latent_losses
        elif self.name == "gazemotion":
            own = {"n_joints": seen.n_joints, "gaze": seen.direction}
            own |= {"observed": seen.observed, "predicted": seen.predicted}
            shape = converted({**sizes, **own}, GazeMotionConfiguration, "model")
            record = records.GazeMotionRecord(windows=seen, network=shape)
            losses = motion_losses
        else:
            record = records.DiffusionRecord(windows=seen, network=_diffusion(self.name, sizes, seen))
        network = record.build()
        origin = start_from(initial, self.name, record, network)
        module = PredictorTraining(self.name, record, network, losses, course, origin)
        if isinstance(network, CoefficientDiffusion) and network.whitening is not None and not origin:
            network.whitening.take(torch.cat([network.residuals(motion) for motion in module.spread(data)]))
        return module


def _diffusion(name: str, model: dict[str, Any], seen: records.SeenWindows) -> DiffusionConfiguration:
    """GazeMoDiff and HumanMAC: ``preset`` is one of the published configurations, other keys differ from it."""
    chosen = model.pop("preset", name)
    own = [each for each in PRESETS if each.startswith("humanmac") is (name == "humanmac")]
    if chosen not in own:
        raise UsageError(f"model.preset: expected one of {', '.join(own)}, found '{chosen}'.")
    if chosen == "no-gaze" and seen.condition is not Condition.POSE:
        raise UsageError("model.preset: 'no-gaze' knows the body alone; add --set model.windows.condition=pose.")
    given = {"n_joints", "gaze", "observed", "predicted"} & set(model)
    if given:
        raise UsageError(f"model.{min(given)}: follows from the windows and their condition; leave it out.")
    # The condition decides about the direction, so that `pose+head` is the head-for-gaze variant of any preset.
    base = preset(chosen, n_joints=seen.n_joints)
    size = {"gaze": seen.direction, "observed": seen.observed, "predicted": seen.predicted}
    return converted({**msgspec.to_builtins(base), **model, **size}, DiffusionConfiguration, "model")


def _belfusion(
    model: dict[str, Any], seen: records.SeenWindows, course: RateCourse, initial: Path | None, data: WindowsDataset
) -> PredictorTraining:
    """BeLFusion's diffusion of behaviours of trained autoencoders, which ``--init`` names."""
    what = "BeLFusion's trained autoencoders"
    start, old = _started("belfusion", initial, seen, what, "belfusion --stage autoencoders")
    unet, objective = split_model_table({**model, "condition": old.network.past}, UNetConfiguration, BestOfNoises)
    weight = objective.decoded_weight
    record = records.BeLFusionRecord(windows=seen, network=unet, behaviour=old.network, decoded_weight=weight)
    try:
        network = record.build()
    except ValueError as error:
        raise UsageError(f"[model]: {error}.") from error
    start.load_into(network.past, "network.past")
    start.load_into(network.behaviour, "network.behaviour")
    losses = partial(belfusion_losses, noises=objective.noises)
    module = PredictorTraining("belfusion", record, network, losses, course, origin_of(start))
    # Codes and behaviours are scaled by their ranges over the training windows and their mirrors.
    past = []
    behaviour = []
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for motion in module.spread(data):
            past.append(network.past.code(motion[:, : old.network.observed]))
            noise = torch.randn(len(motion), old.network.behaviour, generator=generator)
            behaviour.append(network.behaviour.draw(motion[:, seen.observed - old.network.context :], noise))
        for name, values in (("past", torch.cat(past)), ("behaviour", torch.cat(behaviour))):
            getattr(network, f"{name}_min").copy_(values.amin(dim=0))
            getattr(network, f"{name}_max").copy_(values.amax(dim=0))
    return module


def _started(
    name: str, initial: Path | None, seen: records.SeenWindows, what: str, method: str
) -> tuple[Weights, records.NetworkRecord]:
    """Read what a method builds upon, and refuse what was trained on other windows.

    Args:
        name: The method.
        initial: File of what it builds upon.
        seen: The windows that it is trained on.
        what: What it builds upon, in words.
        method: Method, with its stage, that trains that.
    """
    if initial is None:
        command = f"prbench train --method {method} --data WINDOWS… --out DIR"
        raise UsageError(f"--init: {name} builds upon {what}. Train one first (`{command}`) and name its file.")
    start = read_weights(initial, kind="cvae" if method == "cvae" else records.AUTOENCODERS)
    old = start.configuration(records.CVAERecord if method == "cvae" else records.AutoencodersRecord)
    for field in records.SeenWindows.__struct_fields__:
        now = getattr(seen, field)
        then = getattr(old.windows, field)
        if now != then:
            remedy = "Train it again on these, or change model.windows."
            raise UsageError(f"{start.path}: was trained on windows with {field} {then}, these have {now}. {remedy}")
    return start, old
