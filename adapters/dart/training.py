"""Training of DART in one run: first the autoencoder of primitives, then the denoiser of its latents."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from prbench.contract import Adapter
from prbench.errors import UsageError
from prbench_adapters.dart.adapter import DartControl
from prbench_adapters.dart.configuration import HISTORY_FRAMES, DartSettings
from prbench_adapters.dart.frames import Frames
from prbench_adapters.dart.losses import (
    Moment,
    Objective,
    Totals,
    body_losses,
    delta_loss,
    divergence,
    huber,
    moment_of,
)
from prbench_adapters.dart.model import KIND, REPRESENTATION, DartModel, FeatureScaling, pooled_texts
from prbench_adapters.dart.networks import LatentDenoiser, PrimitiveVAE
from prbench_adapters.dart.rollout import next_history
from prbench_adapters.dart.windows import Window, drawn_starts, primitives_of, window
from prbench_adapters.diffusion.layers import TransformerLayer
from prbench_adapters.diffusion.model import TextVectors
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddpm
from prbench_adapters.kinematics import rest_offsets
from prbench_adapters.training import MotionBatch, SequenceDataset
from prbench_adapters.training.task import TrainingModule
from prbench_adapters.training.weights import weights_header

_MEASURED_MOTIONS = 512


@dataclass(frozen=True)
class _Step:
    """One primitive of a training step: standardised features, and what they stand for in metres."""

    history: Float[Tensor, "batch history 276"]
    future: Float[Tensor, "batch future 276"]
    recorded: Frames
    offsets: Float[Tensor, "batch 22 3"]

    @property
    def recorded_future(self) -> Frames:
        return self.recorded.part(HISTORY_FRAMES, self.recorded.joints.shape[1])


class DartTraining(TrainingModule):
    """Both networks with their losses.

    Args:
        vae: In its state before the first step.
        denoiser: Likewise.
        scaling: Of the features.
        texts: Vectors of the captions.
        objective: Weights of the losses and shares of the phases.
        data: The training split, on which the latents' standard deviation is measured once the VAE is trained.
        latent_std: Of the initial weights, if their VAE is kept.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        vae: PrimitiveVAE,
        denoiser: LatentDenoiser,
        *,
        scaling: FeatureScaling,
        texts: TextVectors,
        objective: Objective,
        data: SequenceDataset,
        latent_std: float = 0.0,
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.vae, self.denoiser, self.texts = vae, denoiser, texts
        self.objective, self.data, self.origin = objective, data, origin
        self.configuration, self.schedule = vae.configuration, CosineSchedule(vae.configuration.diffusion_steps)
        self.mean: Tensor
        self.std: Tensor
        self.latent_std: Tensor
        self.register_buffer("mean", scaling.mean, persistent=False)
        self.register_buffer("std", scaling.std, persistent=False)
        self.register_buffer("latent_std", torch.tensor([latent_std]))  # 0 until it is measured; kept in checkpoints

    def forward(self, batch: MotionBatch, step: int) -> dict[str, Tensor]:
        """Losses of consecutive primitives of each motion: of the VAE or of the denoiser, whichever's turn it is.

        Returns:
            ``loss`` and its parts, unweighted (:data:`prbench_adapters.dart.losses.PARTS`).
        """
        _require_one_process()
        moment = self.moment(step)
        generator = self.generator(step)
        rows = self._rows(len(batch), moment)
        cut = self._windows(batch, rows, generator)
        if moment.vae:
            return self._train_vae(cut, moment, generator)
        self._measure_latents()
        texts = tuple(batch.text[row] for row in rows.tolist())
        with self._frozen_vae():
            return self._train_denoiser(cut, texts, moment, generator)

    def moment(self, step: int) -> Moment:
        """Return the phase of a call; a validation is in that of the training around it, without feedback."""
        if step < 0:
            return Moment(not self._measured(), 0.0, 0.0)
        return moment_of(step, self.calls, self.objective)

    def learning_rate_factor(self, step: int) -> float:
        """Falls linearly to 0 in each phase."""
        return max(0.0, 1.0 - self.moment(step).progress)

    def _rows(self, motions: int, moment: Moment) -> Int[Tensor, " windows"]:
        """Number the motion of the batch that each window is cut out of."""
        most = self.objective.vae_batch_size if moment.vae else None
        return torch.arange(min(motions, most or motions)).repeat_interleave(self.objective.windows)

    def _windows(self, batch: MotionBatch, rows: Int[Tensor, " windows"], generator: torch.Generator) -> Window:
        n = self.objective.primitives
        device = batch.joints.device
        starts = drawn_starts(batch.n_frames.cpu()[rows], n, self.configuration, generator)
        with torch.autocast(device.type, enabled=False):
            return window(batch, rows.to(device), starts.to(device), n, self.configuration)

    def _train_vae(self, cut: Window, moment: Moment, generator: torch.Generator) -> dict[str, Tensor]:
        self.vae.train(self.training)
        totals = Totals(cut.valid)
        own: Frames | None = None
        for number in range(self.objective.primitives):
            given = self._given(cut, number, own, moment, generator)
            mean, log_variance = self.vae.encode(given.history, given.future)
            # Validation judges the mean latent, so that its numbers do not waver.
            noise = _normal(mean.shape, generator, mean.device) if self.training else torch.zeros_like(mean)
            features = self.vae.decode(mean + (0.5 * log_variance).exp() * noise, given.history)
            with torch.autocast(features.device.type, enabled=False):
                predicted = self._scaling().frames(features.float())
                body, consistency = body_losses(predicted, given.recorded_future, given.offsets)
                losses = {
                    "reconstruction": huber(features.float(), given.future),
                    "divergence": divergence(mean.float(), log_variance.float()),
                    "body": body,
                    "consistency": consistency,
                    "deltas": delta_loss(predicted, self._scaling().frames(given.history)),
                }
                totals.add(number, losses)
                # Gradients do not run through the history: each primitive learns for itself.
                own = _detached(next_history(predicted)[0])
        weights = self.objective
        return totals.result(
            reconstruction=1.0,
            divergence=weights.kl_weight,
            body=weights.joint_weight,
            consistency=weights.consistency_weight,
            deltas=weights.vae_delta_weight,
        )

    def _train_denoiser(
        self, cut: Window, texts: tuple[str, ...], moment: Moment, generator: torch.Generator
    ) -> dict[str, Tensor]:
        text = self._texts(texts, generator)
        totals = Totals(cut.valid)
        own: Frames | None = None
        for number in range(self.objective.primitives):
            given = self._given(cut, number, own, moment, generator)
            # The mean alone, divided by one number for all dimensions, as diffusion expects a variance near 1.
            clean = self.vae.encode(given.history, given.future)[0].detach() / self.latent_std
            latent = self.denoiser(*self._noisy(clean, generator), text, given.history)
            features = self.vae.decode(latent * self.latent_std, given.history)
            with torch.autocast(features.device.type, enabled=False):
                predicted = self._scaling().frames(features.float())
                losses = {
                    "latent": huber(latent.float(), clean.float()),
                    "reconstruction": huber(features.float(), given.future),
                    "deltas": delta_loss(predicted, self._scaling().frames(given.history)),
                }
                totals.add(number, losses)
            if moment.feedback > 0 and number + 1 < self.objective.primitives:
                own = self._sampled_history(given.history, text, generator)
        weights = self.objective
        return totals.result(latent=weights.latent_weight, reconstruction=1.0, deltas=weights.denoiser_delta_weight)

    def _given(self, cut: Window, number: int, own: Frames | None, moment: Moment, generator: torch.Generator) -> _Step:
        """A primitive with the recorded history, or in some motions with the end of what was predicted before it.

        The future stays the recorded one, seen from the recorded history: the network learns to come back to it.
        """
        with torch.autocast(cut.valid.device.type, enabled=False):
            recorded = cut.primitive(number, self.configuration.future_frames)
            features = self._scaling().standardised(recorded)
            history = features[:, :HISTORY_FRAMES]
            future = features[:, HISTORY_FRAMES:]
            chosen = torch.rand(len(features), generator=generator).to(history.device) < moment.feedback
            if own is not None:
                history = torch.where(chosen[:, None, None], self._scaling().standardised(own), history)
            return _Step(history, future, recorded, rest_offsets(recorded.joints[:, 0]))

    @torch.no_grad()
    def _sampled_history(self, history: Tensor, text: Tensor, generator: torch.Generator) -> Frames:
        """The end of a primitive from the whole sampling loop, as it will be at inference but without guidance."""
        was_training = self.denoiser.training
        self.denoiser.eval()
        shape = (len(history), 1, self.configuration.latent)

        def denoise(noisy: Tensor, step: int) -> Tensor:
            return self.denoiser(noisy, torch.full((len(noisy),), step, device=noisy.device), text, history)

        start = _normal(shape, generator, history.device)
        latent = sample_ddpm(denoise, self.schedule, start, lambda _: _normal(shape, generator, history.device))
        self.denoiser.train(was_training)
        features = self.vae.decode(latent * self.latent_std, history)
        with torch.autocast(history.device.type, enabled=False):
            return next_history(self._scaling().frames(features.float()))[0]

    def _noisy(self, clean: Float[Tensor, "batch 1 latent"], generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Noisy latents and their diffusion steps, uniform."""
        steps = torch.randint(len(self.schedule), (len(clean),), generator=generator)
        level = torch.as_tensor(self.schedule.alphas_cumprod)[steps][:, None, None]
        signal, noise = (values.float().to(clean.device) for values in (level.sqrt(), (1.0 - level).sqrt()))
        return signal * clean + noise * _normal(clean.shape, generator, clean.device), steps.to(clean.device)

    def _texts(self, texts: tuple[str, ...], generator: torch.Generator) -> Float[Tensor, "batch dimension"]:
        hidden: Bool[Tensor, " batch"] = torch.rand(len(texts), generator=generator) < self.objective.text_drop
        return pooled_texts(self.texts, texts).masked_fill(hidden[:, None], 0.0).to(self.mean.device)

    def _scaling(self) -> FeatureScaling:
        return FeatureScaling(self.mean, self.std)

    def _measured(self) -> bool:
        return bool(self.latent_std > 0)

    @torch.no_grad()
    def _measure_latents(self) -> None:
        """Measure the latents' standard deviation, one number for all dimensions, when the denoiser's phase begins."""
        if self._measured():
            return
        n = len(self.data)
        few = min(len(self.data), _MEASURED_MOTIONS)
        # Spread evenly over the split, so that no dataset decides alone.
        places = [place * n // few for place in range(few)]
        self.vae.eval()
        latents = []
        for frames in primitives_of(self.data, places, self.configuration, self.mean.device):
            features = self._scaling().standardised(frames)
            latents.append(self.vae.encode(features[:, :HISTORY_FRAMES], features[:, HISTORY_FRAMES:])[0].float())
        self.latent_std.copy_(torch.cat(latents).std().clamp_min(1e-6))

    @contextmanager
    def _frozen_vae(self) -> Iterator[None]:
        """The decoder passes gradients on to the denoiser and gets none itself, so its optimiser leaves it alone."""
        self.vae.eval().requires_grad_(False)
        try:
            yield
        finally:
            self.vae.requires_grad_(True)

    def weights(self) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Both networks with statistics, and the header of their file."""
        tensors = {f"vae.{name}": tensor for name, tensor in self.vae.state_dict().items()}
        tensors |= {f"denoiser.{name}": tensor for name, tensor in self.denoiser.state_dict().items()}
        tensors |= {"statistics.mean": self.mean, "statistics.std": self.std, "latent.std": self.latent_std}
        metadata = weights_header(KIND, self.configuration, REPRESENTATION)
        return tensors, metadata

    def adapter(self, device: str) -> Adapter | None:
        """``dart`` with a copy of the weights as they are now; None while the VAE is trained."""
        if not self._measured():
            return None
        model = DartModel(
            copy.deepcopy(self.vae).to(device),
            copy.deepcopy(self.denoiser).to(device),
            scaling=self._scaling(),
            latent_std=float(self.latent_std),
            texts=self.texts,
        )
        return DartControl(model, Path("the networks in training"), DartSettings())

    def hidden_matrices(self) -> tuple[nn.Parameter, ...]:
        """The matrices of all transformer layers; without a gradient, those of the other network stay as they are."""
        layers = (module for module in self.modules() if isinstance(module, TransformerLayer))
        return tuple(matrix for layer in layers for matrix in layer.parameters() if matrix.ndim == 2)

    def gradient_groups(self) -> tuple[tuple[nn.Parameter, ...], ...]:
        """Each network's gradient is clipped by its own norm."""
        return tuple(self.vae.parameters()), tuple(self.denoiser.parameters())


def _detached(frames: Frames) -> Frames:
    return Frames(**{name: value.detach() for name, value in vars(frames).items()})


def _normal(shape: tuple[int, ...], generator: torch.Generator, device: torch.device) -> Tensor:
    """Drawn on the CPU, so the numbers are the same on every device."""
    return torch.randn(shape, generator=generator).to(device)


def _require_one_process() -> None:
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        raise UsageError(
            "--devices: dart is trained by one process, because only one of its two networks has gradients at a time;"
            " leave --devices out. At paper size it fits one GPU."
        )
