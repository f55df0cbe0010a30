"""Training of the predictors: windows turned about the vertical and mirrored, losses, and the task of each method."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from prbench.errors import UsageError
from prbench.randomness import named_generator
from prbench_adapters.prediction.belfusion import BehaviourConfiguration, BeLFusion, UNetConfiguration
from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion, held
from prbench_adapters.prediction.configuration import PRESETS, DiffusionConfiguration, preset
from prbench_adapters.prediction.records import (
    AUTOENCODERS,
    Autoencoders,
    AutoencodersRecord,
    BeLFusionRecord,
    CVAERecord,
    DiffusionRecord,
    DLowRecord,
    PredictorNetwork,
    Record,
    SeenWindows,
    contents,
)
from prbench_adapters.prediction.recurrent import CVAE, CVAEConfiguration, DLow, DLowConfiguration, gaussian_kl
from prbench_adapters.training.batches import WindowBatch, WindowChoice, WindowsDataset
from prbench_adapters.training.task import TrainingModule, split_model_table
from prbench_adapters.training.weights import Weights, origin_of, read_weights
from prbench_benchmarks.motion_prediction.batch import Condition

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
    motion: Float[Tensor, "windows frames nodes 3"],
    partners: Sequence[int],
    *,
    turn: Float[Tensor, " windows"],
    mirrored: Bool[Tensor, " windows"],
) -> Float[Tensor, "windows frames nodes 3"]:
    """Windows as they would have been seen turned, or in a mirror.

    Args:
        motion: Metres, Y up; nodes behind the joints are directions, which turn with the body.
        partners: :func:`mirror_partners` of the joints.
        turn: Angle about +Y through the origin, radians; 0 in the frame of the last pose, which has one heading.
        mirrored: Which windows are mirrored at the plane x = 0 before they are turned; left and right joints are
            exchanged, so that the body in the mirror has its labels right.
    """
    order = [*partners, *range(len(partners), motion.shape[2])]
    flipped = motion[:, :, order] * motion.new_tensor([-1.0, 1.0, 1.0])
    motion = torch.where(mirrored[:, None, None, None], flipped, motion)
    cosine, sine = turn.cos()[:, None, None], turn.sin()[:, None, None]
    x, y, z = motion.unbind(-1)
    return torch.stack([cosine * x + sine * z, y, cosine * z - sine * x], dim=-1)


Losses = dict[str, Tensor]
"""Scalars by name; ``loss`` is minimised."""
RecordT = TypeVar("RecordT", bound=Record)
NetworkT = TypeVar("NetworkT", bound=nn.Module)
_VALIDATION_SAMPLES = 5


class RateCourse(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``[model.rate]``: the published courses of the learning rate, on top of ``training.schedule``.

    Raises:
        ValueError: for places outside of the training.
    """

    milestones: tuple[float, ...] = ()
    """Shares of the training after which the rate is multiplied by ``factor``."""
    factor: float = 0.9
    linear_from: float = 1.0
    """Share of the training after which the rate falls linearly to almost 0."""

    def __post_init__(self) -> None:
        if not all(0 < place < 1 for place in self.milestones) or not 0 <= self.linear_from <= 1 or self.factor <= 0:
            raise ValueError("'milestones' and 'linear_from' must lie between 0 and 1, and 'factor' above 0")

    def at(self, progress: float) -> float:
        """Factor on the learning rate after a share of the training, which is below 1."""
        steps = sum(progress >= place for place in self.milestones)
        factor = self.factor**steps
        if progress > self.linear_from:
            factor *= (1.0 - progress) / (1.0 - self.linear_from)
        return factor


class PredictorTraining(TrainingModule, ABC, Generic[RecordT, NetworkT]):
    """A network with its losses; subclasses say what these are.

    Args:
        kind: Of the weights file.
        record: For its header.
        network: In its state before the first step.
        course: Of the learning rate.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self, kind: str, record: RecordT, network: NetworkT, course: RateCourse, origin: tuple[str, ...] = ()
    ) -> None:
        super().__init__()
        self.kind = kind
        self.record = record
        self.network = network
        self.course = course
        self.origin = origin
        self._partners = mirror_partners(record.windows.joints.names)

    def forward(self, batch: WindowBatch, step: int) -> Losses:  # pyright: ignore[reportIncompatibleMethodOverride]  # fed with windows
        """The losses of one batch, and in validation errors of drawn futures.

        Returns:
            ``loss`` and its parts; for negative steps also ``ade`` and ``fde``, metres over the flattened pose as the
            protocol has them, of the best of five futures (DLow: of its K), and ``still_ade`` of a body that stands
            still.
        """
        generator = self.generator(step)
        motion = self.shown(batch)
        if step >= 0:
            motion = self._augmented(motion, generator)
        losses = self.losses(motion, generator, step)
        return losses if step >= 0 else losses | self.errors(motion, step)

    @abstractmethod
    def losses(self, motion: Float[Tensor, "windows frames nodes 3"], generator: torch.Generator, step: int) -> Losses:
        """Return the losses of whole windows by name."""

    @torch.no_grad()
    def errors(self, motion: Float[Tensor, "windows frames nodes 3"], step: int) -> Losses:
        """Errors of drawn futures of the joints."""
        network = self.network
        if not isinstance(network, PredictorNetwork):
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
        return {
            "ade": apart.mean(dim=-1).amin(dim=1).mean(),
            "fde": apart[:, :, -1].amin(dim=1).mean(),
            "still_ade": still.mean(),
        }

    def shown(self, batch: WindowBatch) -> Float[Tensor, "windows frames nodes 3"]:
        """The windows of a batch, with directions that were not measured replaced by measured ones."""
        if batch.direction_valid is None:
            return batch.motion
        observed = self.record.windows.observed
        return torch.cat([held(batch.motion[:, :observed], batch.direction_valid), batch.motion[:, observed:]], dim=1)

    def weights(self) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return the network, frozen parts with it, and the header of its file."""
        return contents(self.kind, self.record, self.network)

    def learning_rate_factor(self, step: int) -> float:
        """Follow the course."""
        return self.course.at(step / self.calls)

    def mirrored(self, motion: Float[Tensor, "windows frames nodes 3"]) -> Float[Tensor, "windows frames nodes 3"]:
        """The windows as a mirror shows them."""
        count = len(motion)
        everywhere = torch.ones(count, dtype=torch.bool, device=motion.device)
        return augmented(motion, self._partners, turn=motion.new_zeros(count), mirrored=everywhere)

    def _augmented(self, motion: Tensor, generator: torch.Generator) -> Tensor:
        count = len(motion)
        mirrored = torch.rand(count, generator=generator) < 0.5
        turn = 2.0 * math.pi * torch.rand(count, generator=generator)
        if self.record.windows.frame == "last-pose":
            turn = torch.zeros(count)  # every body faces the same way
        return augmented(motion, self._partners, turn=turn.to(motion), mirrored=mirrored.to(motion.device))

    @staticmethod
    def _normal(shape: Sequence[int], generator: torch.Generator, like: Tensor) -> Tensor:
        return torch.randn(tuple(shape), generator=generator).to(like)


class DiffusionTraining(PredictorTraining[DiffusionRecord, CoefficientDiffusion]):
    """GazeMoDiff or HumanMAC: the mean squared error of predicted noise."""

    def losses(self, motion: Float[Tensor, "windows frames nodes 3"], generator: torch.Generator, step: int) -> Losses:  # noqa: ARG002
        """Error of the noise at a random step of each window; step 0 is never drawn, as published."""
        shape = self.record.network
        count = len(motion)
        index = torch.randint(1, shape.diffusion_steps, (count,), generator=generator).to(motion.device)
        kept = (torch.rand(count, generator=generator) < shape.condition_kept).to(motion.device)
        noise = self._normal((count, shape.coefficients, shape.values), generator, motion)
        return {"loss": self.network.loss(motion, index, noise, kept)}

    def hidden_matrices(self) -> tuple[nn.Parameter, ...]:
        """The matrices of the denoiser's blocks."""
        return tuple(each for each in self.network.denoiser.blocks.parameters() if each.ndim == 2)


class CVAETraining(PredictorTraining[CVAERecord, CVAE]):
    """CVAE: reconstruction, first frame and divergence."""

    def losses(self, motion: Float[Tensor, "windows frames nodes 3"], generator: torch.Generator, step: int) -> Losses:  # noqa: ARG002
        """The reconstruction of the future from a latent vector that was drawn for it."""
        observed = self.record.windows.observed
        noise = self._normal((len(motion), self.record.network.latent), generator, motion)
        return self.network.loss(motion[:, :observed], motion[:, observed:], noise)


class DLowTraining(PredictorTraining[DLowRecord, DLow]):
    """DLow: K futures that are diverse, one of them near the recorded one, from likely latent vectors."""

    def losses(self, motion: Float[Tensor, "windows frames nodes 3"], generator: torch.Generator, step: int) -> Losses:  # noqa: ARG002
        """The losses of the K futures of one noise vector a window."""
        observed = self.record.windows.observed
        noise = self._normal((len(motion), self.record.cvae.latent), generator, motion)
        return self.network.loss(motion[:, :observed], motion[:, observed:], noise)


class AutoencoderTraining(PredictorTraining[AutoencodersRecord, Autoencoders]):
    """BeLFusion's autoencoders together: they share no parameter, so that one loss trains both.

    Args:
        record: For the header.
        network: In its state before the first step.
        course: Of the learning rate.
        frozen_from: Share of the training after which the behaviour's encoder and the auxiliary decoder stay as they
            are, and the coupler alone learns.
    """

    def __init__(
        self, record: AutoencodersRecord, network: Autoencoders, course: RateCourse, *, frozen_from: float
    ) -> None:
        super().__init__(AUTOENCODERS, record, network, course)
        self.frozen_from = frozen_from

    def losses(self, motion: Float[Tensor, "windows frames nodes 3"], generator: torch.Generator, step: int) -> Losses:
        """Errors of both reconstructions, the divergence, and what the auxiliary decoder finds in the behaviour."""
        shape = self.record.network
        behaviour = self.network.behaviour
        past = self.network.past.loss(motion[:, : shape.observed])
        sequence = motion[:, shape.observed - shape.context :]
        noise = self._normal((len(motion), shape.behaviour), generator, motion)
        if step >= self.frozen_from * self.calls:
            with torch.no_grad():
                drawn = behaviour.encode(sequence).draw(noise)
            error = self._reconstruction(sequence, drawn)
            return {"loss": past + error, "past": past, "squared_error": error}
        found = behaviour.encode(sequence)
        drawn = found.draw(noise)
        error = self._reconstruction(sequence, drawn)
        kl = gaussian_kl(found.mean, found.log_deviation).sum() / len(motion)
        # The same number as `drawn`, of whose gradient 1 - delta goes on: the auxiliary decoder learns from its whole
        # error, and the encoder from what the published program leaves of it, which makes it hide the poses.
        hidden = drawn.detach() + (1.0 - shape.delta) * (drawn - drawn.detach())
        auxiliary = (behaviour.decode_without_context(hidden) - sequence).square().sum() / len(motion)
        total = past + error + shape.beta * kl + auxiliary
        return {"loss": total, "past": past, "squared_error": error, "kl": kl, "auxiliary": auxiliary}

    def _reconstruction(
        self, sequence: Float[Tensor, "windows frames nodes 3"], drawn: Float[Tensor, "windows behaviour"]
    ) -> Float[Tensor, ""]:
        """Squared error of the future that a behaviour makes of its context, m² a window."""
        context, future = sequence.split([self.record.network.context, self.record.network.predicted], dim=1)
        decoded = self.network.behaviour.decode(context, drawn[:, None])[:, 0]
        return (decoded - future).square().sum() / len(sequence)


class BeLFusionTraining(PredictorTraining[BeLFusionRecord, BeLFusion]):
    """BeLFusion's diffusion of behaviours: the best of several noises.

    Args:
        record: For the header.
        network: In its state before the first step, with trained autoencoders and their ranges.
        course: Of the learning rate.
        origin: Lines for the card about the autoencoders.
        noises: How many are tried for each window.
    """

    def __init__(
        self, record: BeLFusionRecord, network: BeLFusion, course: RateCourse, origin: tuple[str, ...], *, noises: int
    ) -> None:
        super().__init__("belfusion", record, network, course, origin)
        self.noises = noises

    def losses(self, motion: Float[Tensor, "windows frames nodes 3"], generator: torch.Generator, step: int) -> Losses:  # noqa: ARG002
        """Errors of the clean behaviour and of the future that is decoded from it, at one step for each window."""
        size = self.record.behaviour.behaviour
        count = len(motion)
        index = torch.randint(self.record.network.steps, (count,), generator=generator).to(motion.device)
        noise = self._normal((count, self.noises, size), generator, motion)
        behaviour_noise = self._normal((count, size), generator, motion)
        loss = self.network.loss(motion, index, noise, behaviour_noise)
        return {name: values.mean() for name, values in loss.items()}


TRAIN = "train"
STAGES_OF_BELFUSION = ("autoencoders", "diffusion")
_Struct = TypeVar("_Struct", bound=msgspec.Struct)
_TOGETHER = 64
_MOST_WINDOWS = 4096
"""Windows that statistics are taken from, spread evenly over the training split."""


class Phases(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of BeLFusion's autoencoders beside their sizes."""

    frozen_from: float = 0.5
    """Share of the training after which the coupler alone learns."""


class BestOfNoises(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of BeLFusion's diffusion beside the sizes of the U-Net."""

    noises: int = 50
    """Noises that are tried for each window, of which the best one counts."""
    decoded_weight: float = 5.0
    """Weight of the decoded future beside the behaviour."""


@dataclass(frozen=True)
class Request:
    """What a builder makes a module from."""

    name: str
    model: dict[str, Any]
    """The table ``[model]`` without ``windows`` and ``rate``."""
    seen: SeenWindows
    course: RateCourse
    data: WindowsDataset
    initial: Path | None
    stage: str


@dataclass(frozen=True)
class PredictorTask:
    """A training task that is fed windows (:class:`prbench_adapters.training.task.WindowsTask`)."""

    name: str
    builder: Callable[[Request], TrainingModule]
    stages: tuple[str, ...] = (TRAIN,)
    configurations: str = "prbench_adapters.prediction"

    def window_choice(self, model: Mapping[str, Any]) -> WindowChoice:
        """Read ``[model.windows]``.

        Raises:
            UsageError: for an unknown key or an impossible value.
        """
        return _converted(model.get("windows", {}), WindowChoice, "model.windows")

    def build(
        self, model: Mapping[str, Any], *, data: WindowsDataset, initial: Path | None, stage: str
    ) -> TrainingModule:
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
        course = _converted(model.get("rate", {}), RateCourse, "model.rate")
        sizes = {key: value for key, value in model.items() if key not in ("windows", "rate")}
        return self.builder(Request(self.name, sizes, SeenWindows.of(data), course, data, initial, stage))


def diffusion(request: Request) -> DiffusionTraining:
    """GazeMoDiff and HumanMAC: ``preset`` is one of the published configurations, other keys differ from it."""
    changes = dict(request.model)
    name = changes.pop("preset", request.name)
    own = [each for each in PRESETS if each.startswith("humanmac") is (request.name == "humanmac")]
    if name not in own:
        raise UsageError(f"model.preset: expected one of {', '.join(own)}, found '{name}'.")
    seen = request.seen
    if name == "no-gaze" and seen.condition is not Condition.POSE:
        raise UsageError("model.preset: 'no-gaze' knows the body alone; add --set model.windows.condition=pose.")
    given = {"n_joints", "gaze", "observed", "predicted"} & set(changes)
    if given:
        raise UsageError(f"model.{min(given)}: follows from the windows and their condition; leave it out.")
    # The condition decides about the direction, so that `pose+head` is the head-for-gaze variant of any preset.
    base = preset(name, n_joints=seen.n_joints)
    size = {"gaze": seen.direction, "observed": seen.observed, "predicted": seen.predicted}
    network = _converted({**msgspec.to_builtins(base), **changes, **size}, DiffusionConfiguration, "model")
    record = DiffusionRecord(windows=seen, network=network)
    model = record.build()
    origin = _started(request, model, record)
    module = DiffusionTraining(request.name, record, model, request.course, origin)
    if model.whitening is not None and not origin:
        model.whitening.take(torch.cat([model.residuals(motion) for motion in _motions(module, request.data)]))
    return module


def cvae(request: Request) -> CVAETraining:
    """CVAE; a direction counts as one more joint."""
    seen = request.seen
    sizes = {"n_joints": seen.nodes, "predicted": seen.predicted}
    record = CVAERecord(windows=seen, network=_converted({**request.model, **sizes}, CVAEConfiguration, "model"))
    model = record.build()
    origin = _started(request, model, record)
    return CVAETraining(request.name, record, model, request.course, origin)


def dlow(request: Request) -> DLowTraining:
    """DLow's sampler for a trained CVAE, which ``--init`` names.

    Raises:
        UsageError: without one.
        InputFileError: if the file is none, or was trained on other windows.
    """
    start = _required(request, "cvae", "a trained CVAE", "prbench train --method cvae --data WINDOWS… --out DIR")
    old = start.configuration(CVAERecord)
    record = DLowRecord(
        windows=request.seen, network=_converted(request.model, DLowConfiguration, "model"), cvae=old.network
    )
    _require_same_windows(request, start, old.windows)
    decoder = CVAE(old.network)
    start.load_into(decoder, "network")
    model = record.build()
    model.cvae.load_state_dict(decoder.state_dict())
    return DLowTraining(request.name, record, model, request.course, origin_of(start))


def belfusion(request: Request) -> AutoencoderTraining | BeLFusionTraining:
    """BeLFusion's stages: its autoencoders, then the diffusion of behaviours, for which ``--init`` names them."""
    if request.stage == STAGES_OF_BELFUSION[0]:
        seen = request.seen
        sizes = {"n_joints": seen.nodes, "observed": seen.observed, "predicted": seen.predicted}
        network, phases = split_model_table({**request.model, **sizes}, BehaviourConfiguration, Phases)
        record = AutoencodersRecord(windows=seen, network=network)
        return AutoencoderTraining(record, record.build(), request.course, frozen_from=phases.frozen_from)
    command = "prbench train --method belfusion --stage autoencoders --data WINDOWS… --out DIR"
    start = _required(request, AUTOENCODERS, "BeLFusion's trained autoencoders", command)
    old = start.configuration(AutoencodersRecord)
    _require_same_windows(request, start, old.windows)
    table = {**request.model, "condition": old.network.past}
    unet, objective = split_model_table(table, UNetConfiguration, BestOfNoises)
    record = BeLFusionRecord(
        windows=request.seen, network=unet, behaviour=old.network, decoded_weight=objective.decoded_weight
    )
    try:
        model = record.build()
    except ValueError as error:
        raise UsageError(f"[model]: {error}.") from error
    trained = Autoencoders(old.network)
    start.load_into(trained, "network")
    model.past.load_state_dict(trained.past.state_dict())
    model.behaviour.load_state_dict(trained.behaviour.state_dict())
    module = BeLFusionTraining(record, model, request.course, origin_of(start), noises=objective.noises)
    _take_ranges(module, request.data)
    return module


@torch.no_grad()
def _take_ranges(module: BeLFusionTraining, data: WindowsDataset) -> None:
    """Set the ranges that codes and behaviours are scaled by to those of the training windows and of their mirrors."""
    model = module.network
    seen = module.record.windows
    past = []
    behaviour = []
    generator = torch.Generator().manual_seed(0)
    for motion in _motions(module, data):
        past.append(model.past.code(motion[:, : seen.observed]))
        noise = torch.randn(len(motion), module.record.behaviour.behaviour, generator=generator)
        sequence = motion[:, seen.observed - module.record.behaviour.context :]
        behaviour.append(model.behaviour.encode(sequence).draw(noise))
    for name, values in (("past", torch.cat(past)), ("behaviour", torch.cat(behaviour))):
        getattr(model, f"{name}_min").copy_(values.amin(dim=0))
        getattr(model, f"{name}_max").copy_(values.amax(dim=0))


def _motions(module: DiffusionTraining | BeLFusionTraining, data: WindowsDataset) -> Iterator[torch.Tensor]:
    """Yield windows of the training split, spread over it, each followed by its mirror."""
    places = data.spread(-(-_MOST_WINDOWS // len(data.tables)))
    for first in range(0, len(places), _TOGETHER):
        motion = module.shown(data.collate([data[place] for place in places[first : first + _TOGETHER]]))
        yield motion
        yield module.mirrored(motion)


def _started(request: Request, model: torch.nn.Module, record: Record) -> tuple[str, ...]:
    """Put initial weights of the same method in place, if some were given."""
    if request.initial is None:
        return ()
    start = read_weights(request.initial, kind=request.name)
    start.require_same(record, apart_from=())
    start.load_into(model, "network")
    return origin_of(start)


def _required(request: Request, kind: str, what: str, command: str) -> Weights:
    if request.initial is None:
        raise UsageError(f"--init: {request.name} builds upon {what}. Train one first (`{command}`) and name its file.")
    return read_weights(request.initial, kind=kind)


def _require_same_windows(request: Request, start: Weights, old: SeenWindows) -> None:
    for name in SeenWindows.__struct_fields__:
        now = getattr(request.seen, name)
        then = getattr(old, name)
        if now != then:
            raise UsageError(
                f"{start.path}: was trained on windows with {name} {then}, these have {now}. Train it again on these,"
                " or change model.windows."
            )


def _converted(table: object, kind: type[_Struct], where: str) -> _Struct:
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise UsageError(f"[{where}]: {error}.") from error
