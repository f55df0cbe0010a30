"""Training of the predictors: each network with its published loss on augmented windows.

Source: docs/specification/prediction-networks.md#training. In validation, futures are drawn as well, and their errors
stand beside the losses.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, TypeVar

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from prbench.randomness import named_generator
from prbench_adapters.prediction.augmentation import augmented, mirror_partners
from prbench_adapters.prediction.belfusion import BeLFusion
from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion
from prbench_adapters.prediction.cvae import CVAE
from prbench_adapters.prediction.dlow import DLow
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
    contents,
)
from prbench_adapters.prediction.recurrent import gaussian_kl
from prbench_adapters.prediction.window_dct import held
from prbench_adapters.training.task import TrainingModule
from prbench_adapters.training.windows import WindowBatch

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
        loss = self.network.loss(motion[:, :observed], motion[:, observed:], noise)
        return {
            "loss": loss.total,
            "squared_error": loss.squared_error,
            "first_frame": loss.first_frame,
            "kl": loss.kl,
        }


class DLowTraining(PredictorTraining[DLowRecord, DLow]):
    """DLow: K futures that are diverse, one of them near the recorded one, from likely latent vectors."""

    def losses(self, motion: Float[Tensor, "windows frames nodes 3"], generator: torch.Generator, step: int) -> Losses:  # noqa: ARG002
        """The losses of the K futures of one noise vector a window."""
        observed = self.record.windows.observed
        noise = self._normal((len(motion), self.record.cvae.latent), generator, motion)
        loss = self.network.loss(motion[:, :observed], motion[:, observed:], noise)
        return {"loss": loss.total, "kl": loss.kl, "diversity": loss.diversity, "best_of_k": loss.best_of_k}


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
        return {"loss": loss.total.mean(), "latent": loss.latent.mean(), "decoded": loss.decoded.mean()}
