"""The training tasks of the predictors: from a ``[model]`` table, windows and initial weights to a module to train."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import torch

from prbench.errors import UsageError
from prbench.prediction.batch import Condition
from prbench_adapters.prediction.behaviour import BehaviourConfiguration
from prbench_adapters.prediction.configuration import PRESETS, DiffusionConfiguration, preset
from prbench_adapters.prediction.cvae import CVAE, CVAEConfiguration
from prbench_adapters.prediction.dlow import DLowConfiguration
from prbench_adapters.prediction.latent_unet import UNetConfiguration
from prbench_adapters.prediction.records import (
    AUTOENCODERS,
    Autoencoders,
    AutoencodersRecord,
    BeLFusionRecord,
    CVAERecord,
    DiffusionRecord,
    DLowRecord,
    Record,
    SeenWindows,
)
from prbench_adapters.prediction.training import (
    AutoencoderTraining,
    BeLFusionTraining,
    CVAETraining,
    DiffusionTraining,
    DLowTraining,
    RateCourse,
)
from prbench_adapters.training.task import TrainingModule, split_model_table
from prbench_adapters.training.weights import Weights, origin_of, read_weights
from prbench_adapters.training.windows import WindowChoice, WindowsDataset

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
        return _autoencoders(request)
    return _behaviour_diffusion(request)


def _autoencoders(request: Request) -> AutoencoderTraining:
    seen = request.seen
    sizes = {"n_joints": seen.nodes, "observed": seen.observed, "predicted": seen.predicted}
    network, phases = split_model_table({**request.model, **sizes}, BehaviourConfiguration, Phases)
    record = AutoencodersRecord(windows=seen, network=network)
    return AutoencoderTraining(record, record.build(), request.course, frozen_from=phases.frozen_from)


def _behaviour_diffusion(request: Request) -> BeLFusionTraining:
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
