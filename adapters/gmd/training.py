"""Training of both networks of GMD in one run (docs/specification/gmd.md#training)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import torch
from jaxtyping import Bool, Float, Int
from torch import nn

from prbench.contract import Adapter
from prbench.training import MotionBatch
from prbench.training.task import TrainingModule
from prbench.training.weights import representation_entry
from prbench_adapters.diffusion.schedule import CosineSchedule
from prbench_adapters.diffusion.text_vectors import TextVectors
from prbench_adapters.gmd.adapter import GMD
from prbench_adapters.gmd.features import N_ROOT, FeatureSpace, with_absolute_root
from prbench_adapters.gmd.model import KIND, GMDModel, GMDNetworks, caption_vectors
from prbench_adapters.gmd.stages import GMDSettings
from prbench_adapters.gmd.unet import TemporalUNet


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is trained beside the configuration of the networks."""

    text_drop: float = 0.1
    """Share of sequences whose text is hidden, so that guidance has an unconditional model."""


@dataclass(frozen=True)
class Draw:
    """What is random in one training step of one network."""

    step: Int[torch.Tensor, " batch"]
    without_text: Bool[torch.Tensor, " batch"]
    noise: Float[torch.Tensor, "batch frames columns"]


class GMDTraining(TrainingModule):
    """Motion and trajectory network with their losses; the networks share nothing but batches and optimiser.

    Args:
        networks: In their state before the first step.
        space: Statistics and projection.
        texts: Vectors of the captions.
        objective: How often the text is hidden.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        networks: GMDNetworks,
        *,
        space: FeatureSpace,
        texts: TextVectors,
        objective: Objective,
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.networks, self.texts, self.objective, self.origin = networks, texts, objective, origin
        self.configuration = networks.configuration
        self._space = space
        alphas_cumprod = torch.as_tensor(CosineSchedule(self.configuration.diffusion_steps).alphas_cumprod)
        self.signal: torch.Tensor
        self.noise: torch.Tensor
        for name, values in (("signal", alphas_cumprod.sqrt()), ("noise", (1 - alphas_cumprod).sqrt())):
            self.register_buffer(name, values.float(), persistent=False)  # no part of checkpoints

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Mean squared errors over the valid frames: of projected clean features, and of the trajectory's noise.

        Returns:
            ``loss``, which is the sum of ``motion`` and ``trajectory``.
        """
        with torch.autocast(batch.features.device.type, enabled=False):
            space = self.space(batch.features.device)
            raw = with_absolute_root(batch.features)
            standardised = space.standardised(raw).masked_fill(batch.padding[..., None], 0.0)
            projected = space.projected(standardised)
        text = caption_vectors(self.texts, batch.text).to(batch.features.device, non_blocking=True)
        generator = self.generator(step)
        motion, trajectory = self.draw(projected, generator), self.draw(standardised[..., :N_ROOT], generator)
        clean = self._predicted(self.networks.motion, projected, motion, text, batch)
        noise = self._predicted(self.networks.trajectory, standardised[..., :N_ROOT], trajectory, text, batch)
        losses = {
            "motion": _mean_squared(clean - projected, batch.padding),
            "trajectory": _mean_squared(noise - trajectory.noise, batch.padding),
        }
        return {"loss": losses["motion"] + losses["trajectory"], **{k: loss.detach() for k, loss in losses.items()}}

    def draw(self, clean: Float[torch.Tensor, "batch frames columns"], generator: torch.Generator) -> Draw:
        """Draw for one network; numbers come from the CPU, so they are the same on every device."""
        n = len(clean)
        step = torch.randint(len(self.signal), (n,), generator=generator)
        without_text = torch.rand(n, generator=generator) < self.objective.text_drop
        noise = torch.randn(clean.shape, generator=generator)
        return Draw(*(values.to(clean.device, non_blocking=True) for values in (step, without_text, noise)))

    def _predicted(
        self, network: TemporalUNet, clean: torch.Tensor, draw: Draw, text: torch.Tensor, batch: MotionBatch
    ) -> torch.Tensor:
        noisy = self.signal[draw.step][:, None, None] * clean + self.noise[draw.step][:, None, None] * draw.noise
        text = text.masked_fill(draw.without_text[:, None], 0.0)
        window = self.configuration.window(clean.shape[1])
        return network(noisy, draw.step, text, batch.n_frames, window=window).float()

    def space(self, device: torch.device) -> FeatureSpace:
        """Statistics and projection on a device; a resumed run makes them anew, so no checkpoint holds them."""
        if self._space.mean.device != device:
            self._space = self._space.to(device)
        return self._space

    def gradient_groups(self) -> Sequence[Sequence[nn.Parameter]]:
        """Each network's gradient is clipped by its own norm, as if they were trained apart."""
        return tuple(self.networks.motion.parameters()), tuple(self.networks.trajectory.parameters())

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Both networks with statistics and projection, and the header of their file."""
        tensors = {f"networks.{name}": tensor for name, tensor in self.networks.state_dict().items()}
        space = self._space
        tensors |= {"statistics.mean": space.mean, "statistics.std": space.std, "projection": space.projection}
        metadata = {
            "kind": KIND,
            "configuration": msgspec.json.encode(self.configuration).decode(),
            "representation": representation_entry(self.configuration.representation),
        }
        return tensors, metadata

    def adapter(self, device: str) -> Adapter:
        """``gmd`` with a copy of the weights as they are now."""
        model = GMDModel(copy.deepcopy(self.networks).to(device), space=self._space, texts=self.texts)
        return GMD(model, Path("the networks in training"), GMDSettings())

    def learned_from(self) -> tuple[str, ...]:
        """The initial weights and the text encoder."""
        return self.origin


def _mean_squared(
    error: Float[torch.Tensor, "batch frames columns"], padding: Bool[torch.Tensor, "batch frames"]
) -> Float[torch.Tensor, ""]:
    """Over columns and valid frames."""
    summed = torch.where(padding[..., None], 0.0, error.square()).sum()
    return summed / ((~padding).sum() * error.shape[-1])
