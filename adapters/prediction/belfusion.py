"""BeLFusion: diffusion of behaviours, each of which is then decoded from the last observed frames.

Source: docs/specification/prediction-baselines.md#belfusion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from prbench_adapters.diffusion.sampling import Chain, ddim_factors
from prbench_adapters.prediction.behaviour import BehaviourAutoencoder, BehaviourConfiguration, PastAutoencoder
from prbench_adapters.prediction.latent_unet import LatentUNet, UNetConfiguration
from prbench_adapters.prediction.recurrent import latent_noise

_OFFSET = 1e-4
_LARGEST_BETA = 0.999


def square_root_schedule(steps: int) -> Chain:
    """β_i = min(1 - f((i + 1)/T)/f(i/T), 0.999) with f(s) = max(0, 1 - √(s + 0.0001))."""
    level = np.maximum(0.0, 1.0 - np.sqrt(np.arange(steps + 1) / steps + _OFFSET))
    betas = np.minimum(1.0 - level[1:] / level[:-1], _LARGEST_BETA)
    return Chain(np.arange(steps), np.cumprod(1.0 - betas))


@dataclass(frozen=True)
class BeLFusionLoss:
    """Of each window: the best sample's error of the latent vector, and of the decoded future."""

    latent: Float[Tensor, " windows"]
    decoded: Float[Tensor, " windows"]
    total: Float[Tensor, " windows"]


class BeLFusion(nn.Module):
    """Both autoencoders, trained before and frozen here, and the diffusion of scaled behaviours.

    Args:
        behaviour: Sizes of the autoencoders.
        unet: Sizes of the denoiser.
        decoded_weight: Weight of the decoded future in the loss.

    Raises:
        ValueError: if the sizes of the parts do not fit.
    """

    def __init__(
        self, behaviour: BehaviourConfiguration, unet: UNetConfiguration, *, decoded_weight: float = 5.0
    ) -> None:
        super().__init__()
        if unet.latent != behaviour.behaviour or unet.condition != behaviour.past:
            raise ValueError(
                f"the U-Net is made for behaviours of {unet.latent} and codes of {unet.condition} numbers, the"
                f" autoencoders for {behaviour.behaviour} and {behaviour.past}"
            )
        self.configuration, self.decoded_weight = behaviour, decoded_weight
        self.past = PastAutoencoder(behaviour).requires_grad_(False)
        self.behaviour = BehaviourAutoencoder(behaviour).requires_grad_(False)
        self.denoiser = LatentUNet(unet)
        self.schedule = square_root_schedule(unet.steps)
        for name, size in (("past", behaviour.past), ("behaviour", behaviour.behaviour)):
            self.register_buffer(f"{name}_min", -torch.ones(size))
            self.register_buffer(f"{name}_max", torch.ones(size))
        self.past_min: Tensor
        self.past_max: Tensor
        self.behaviour_min: Tensor
        self.behaviour_max: Tensor

    def condition(self, observed: Float[Tensor, "windows observed joints 3"]) -> Float[Tensor, "windows past"]:
        """The code of the past, ±1 over the training windows."""
        return _scaled(self.past.code(observed), self.past_min, self.past_max)

    def target(
        self, motion: Float[Tensor, "windows frames joints 3"], noise: Float[Tensor, "windows behaviour"]
    ) -> Float[Tensor, "windows behaviour"]:
        """The behaviour of whole windows, drawn with standard normal noise, ±1 over the training windows."""
        drawn = self.behaviour.encode(motion[:, self._context_start :]).draw(noise)
        return _scaled(drawn, self.behaviour_min, self.behaviour_max)

    def decode(
        self,
        observed: Float[Tensor, "windows observed joints 3"],
        latent: Float[Tensor, "windows samples behaviour"],
    ) -> Float[Tensor, "windows samples predicted joints 3"]:
        """Futures in metres of scaled behaviours."""
        behaviour = (latent + 1.0) / 2.0 * (self.behaviour_max - self.behaviour_min) + self.behaviour_min
        return self.behaviour.decode(observed[:, self._context_start :], behaviour)

    def denoised(
        self,
        noisy: Float[Tensor, "windows samples behaviour"],
        step: Int[Tensor, " windows"],
        condition: Float[Tensor, "windows past"],
    ) -> Float[Tensor, "windows samples behaviour"]:
        """Clean behaviours of noisy ones."""
        samples = noisy.shape[1]
        told, steps = condition.repeat_interleave(samples, dim=0), step.repeat_interleave(samples)
        return self.denoiser(noisy.flatten(0, 1), steps, told).unflatten(0, (-1, samples))

    def loss(
        self,
        motion: Float[Tensor, "windows frames joints 3"],
        step: Int[Tensor, " windows"],
        noise: Float[Tensor, "windows samples behaviour"],
        behaviour_noise: Float[Tensor, "windows behaviour"],
    ) -> BeLFusionLoss:
        """Errors of the best of several noises at one step.

        Args:
            motion: Whole windows, metres.
            step: Index in the training schedule, 0 … T - 1.
            noise: Standard normal, for each sample.
            behaviour_noise: Standard normal, for the behaviour that is to be found.
        """
        observed = motion[:, : self.configuration.observed]
        with torch.no_grad():
            condition = self.condition(observed)
            target = self.target(motion, behaviour_noise)[:, None]
            decoded_target = self.decode(observed, target).flatten(2)
        level = torch.from_numpy(self.schedule.alphas_cumprod).to(noise)[step][:, None, None]
        clean = self.denoised(level.sqrt() * target + (1.0 - level).sqrt() * noise, step, condition)
        latent = (clean - target).abs().sum(dim=-1).amin(dim=1)
        decoded = (self.decode(observed, clean).flatten(2) - decoded_target).norm(dim=-1).amin(dim=1)
        return BeLFusionLoss(latent, decoded, latent + self.decoded_weight * decoded)

    @torch.no_grad()
    def predict(
        self, observed: Float[Tensor, "windows observed joints 3"], seeds: Sequence[Sequence[int]]
    ) -> Float[Tensor, "windows samples predicted joints 3"]:
        """Draw continuations in metres.

        Args:
            observed: Joints, metres.
            seeds: A seed for each sample of each window (``prbench.randomness.noise_seed``); nothing else decides
                about its noise.
        """
        start = latent_noise(seeds, self.configuration.behaviour, observed)
        *_, (_, clean) = self.states(start, self.condition(observed))
        return self.decode(observed, clean)

    @torch.no_grad()
    def states(
        self, start: Float[Tensor, "windows samples behaviour"], condition: Float[Tensor, "windows past"]
    ) -> Iterator[tuple[Tensor, Tensor]]:
        """Walk from noise to behaviours by DDIM (η = 0), the noisiest step first.

        Yields:
            The state after each step, and the clean estimate within ±1 that it was made from, both (windows, samples,
            behaviour); those of the last step are equal.
        """
        of_clean, of_state = ddim_factors(self.schedule.alphas_cumprod, self.schedule.alphas_cumprod_previous)
        state = start
        for index in reversed(range(len(self.schedule))):
            step = torch.full((len(start),), index, device=start.device)
            clean = self.denoised(state, step, condition).clamp(-1.0, 1.0)
            state = float(of_clean[index]) * clean + float(of_state[index]) * state
            yield state, clean

    @property
    def _context_start(self) -> int:
        return self.configuration.observed - self.configuration.context


def _scaled(values: Tensor, smallest: Tensor, largest: Tensor) -> Tensor:
    return 2.0 * (values - smallest) / (largest - smallest) - 1.0
