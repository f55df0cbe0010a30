"""Latents of primitives from noise, with classifier-free guidance by the text."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from prbench_adapters.dart.networks import LatentDenoiser
from prbench_adapters.dart.prepared import PreparedDenoiser
from prbench_adapters.dart.rollout import SampleLatent
from prbench_adapters.diffusion.sampling import sample_ddim, sample_ddpm
from prbench_adapters.diffusion.schedule import CosineSchedule


class GuidedDenoiser:
    """A denoiser under B texts.

    Args:
        denoiser: Of latents, in evaluation mode.
        text: One vector each.
        scale: Of the guidance; 1 is the conditional estimate alone, in one pass, anything else takes two.
    """

    def __init__(self, denoiser: LatentDenoiser, text: Float[Tensor, "batch dimension"], scale: float) -> None:
        self.denoiser, self.text, self.scale = denoiser, text, scale
        self.doubled = scale != 1.0
        self.passes = 0
        """Network passes so far, summed over sequences."""

    def under(self, history: Float[Tensor, "batch history 276"]) -> Callable[[Tensor, int], Tensor]:
        """The guided estimate of clean latents as the samplers take it: of noisy latents and diffusion step.

        Where there are fewer histories than texts, they are those of the first motions.
        """
        text = self.text[: len(history)]
        texts = torch.cat((text, torch.zeros_like(text))) if self.doubled else text
        histories = torch.cat((history, history)) if self.doubled else history

        prepared = PreparedDenoiser(self.denoiser, texts, histories)

        def denoise(noisy: Tensor, step: int) -> Tensor:
            rows = torch.cat((noisy, noisy)) if self.doubled else noisy
            self.passes += len(rows)
            clean = prepared(rows, step)
            if not self.doubled:
                return clean
            conditional, unconditional = clean.chunk(2)
            return torch.lerp(unconditional, conditional, self.scale)

        return denoise


def by_ddim(
    denoiser: GuidedDenoiser,
    schedule: CosineSchedule,
    noise: Float[Tensor, "primitives batch 1 latent"],
    *,
    steps: int | None = None,
) -> SampleLatent:
    """A fixed, differentiable map from the noise of each primitive to its latent: η = 0, all steps unless given."""

    def sample(number: int, history: Tensor) -> Tensor:
        return sample_ddim(denoiser.under(history), schedule, noise[number, : len(history)], steps=steps)

    return sample


def by_ddpm(
    denoiser: GuidedDenoiser, schedule: CosineSchedule, draw: Callable[[], Float[Tensor, "batch 1 latent"]]
) -> SampleLatent:
    """Ancestral sampling with all steps; ``draw`` is called for the start and once a step but the last."""

    def sample(number: int, history: Tensor) -> Tensor:  # noqa: ARG001 - every primitive draws
        n = len(history)
        return sample_ddpm(denoiser.under(history), schedule, draw()[:n], lambda _: draw()[:n])

    return sample
