"""GazeMoDiff and HumanMAC as one model: training loss, and prediction by masked completion.

Sources: docs/specification/gazemodiff.md#diffusion-and-sampling, docs/specification/prediction-baselines.md#humanmac.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from prbench.randomness import sequence_generator
from prbench_adapters.diffusion.batches import SequenceNoise
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.prediction.configuration import DiffusionConfiguration
from prbench_adapters.prediction.denoiser import CoefficientDenoiser, PreparedCondition
from prbench_adapters.prediction.encoder import ConditionEncoder
from prbench_adapters.prediction.whitening import Whitening
from prbench_adapters.prediction.window_dct import WindowDCT, padded

_Noise = Callable[[], Float[Tensor, "windows samples coefficients values"]]
"""The next standard normal noise of every sample."""


class CoefficientDiffusion(nn.Module):
    """Diffusion of the DCT coefficients of whole windows, under the condition of their observed frames.

    Args:
        configuration: Sizes and parts; :func:`~prbench_adapters.prediction.configuration.preset` has the published.
    """

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.transform = WindowDCT(configuration.coefficients, configuration.observed, configuration.frames)
        self.encoder = ConditionEncoder(configuration) if configuration.encoder else None
        self.denoiser = CoefficientDenoiser(configuration)
        sizes = (configuration.coefficients, configuration.values)
        self.whitening = Whitening(*sizes) if configuration.whitened else None
        self.schedule = CosineSchedule(configuration.diffusion_steps)

    def condition(
        self, observed: Float[Tensor, "windows coefficients values"]
    ) -> Float[Tensor, "windows coefficients values"]:
        """Encode the coefficients of padded observations for the denoiser; without an encoder they stay as they are."""
        return observed if self.encoder is None else self.encoder(observed)

    def loss(
        self,
        motion: Float[Tensor, "windows frames nodes 3"],
        step: Int[Tensor, " windows"],
        noise: Float[Tensor, "windows coefficients values"],
        kept: Bool[Tensor, " windows"] | None = None,
        gaze_valid: Bool[Tensor, "windows observed"] | None = None,
    ) -> Float[Tensor, ""]:
        """Mean squared error of the predicted noise, or velocity.

        Args:
            motion: Whole windows: joints in metres, and the direction as the last node if the model has one.
            step: Index in the training schedule; from 1, as the published programs never draw 0.
            noise: Standard normal.
            kept: Which windows keep their condition; None if all do.
            gaze_valid: Which observed directions were measured (:func:`~.window_dct.padded`).
        """
        known = self.transform(padded(motion[:, : self.configuration.observed], motion.shape[1], gaze_valid))
        condition = self.condition(known)
        clean = self.transform(motion)
        if self.configuration.residual:
            clean = clean - known
        if self.whitening is not None:
            clean = self.whitening(clean)
        level = torch.from_numpy(self.schedule.alphas_cumprod).to(clean)[step][:, None, None]
        noisy = level.sqrt() * clean + (1.0 - level).sqrt() * noise
        predicted = self.denoiser(noisy[:, None], step, self._prepared(condition, kept))
        wanted = noise
        if self.configuration.predicts == "velocity":
            wanted = level.sqrt() * noise - (1.0 - level).sqrt() * clean
        return (predicted[:, 0] - wanted).square().mean()

    @torch.no_grad()
    def predict(
        self,
        observed: Float[Tensor, "windows observed nodes 3"],
        seeds: Sequence[Sequence[int]],
        gaze_valid: Bool[Tensor, "windows observed"] | None = None,
    ) -> Float[Tensor, "windows samples predicted nodes 3"]:
        """Draw continuations of observations; the model must be in evaluation mode.

        Args:
            observed: Joints in metres, and the direction as the last node if the model has one.
            seeds: A seed for each sample of each window (``prbench.randomness.noise_seed``). Nothing else decides
                about its noise, so five samples are the first five of fifty.
            gaze_valid: Which directions were measured (:func:`~.window_dct.padded`).

        Returns:
            The frames after the observed ones, with the direction that was predicted too.

        Raises:
            ValueError: for observations of another shape, and without any sample.
        """
        configuration = self.configuration
        expected = (len(seeds), configuration.observed, configuration.nodes, 3)
        if tuple(observed.shape) != expected:
            raise ValueError(f"expected observations of shape {expected}, found {tuple(observed.shape)}")
        samples = len(seeds[0]) if seeds else 0
        if not samples or any(len(row) != samples for row in seeds):
            raise ValueError("each window needs a seed for each of at least one sample, and as many as the others")
        flat = [seed for row in seeds for seed in row]
        rows = np.full(len(flat), configuration.coefficients)
        source = SequenceNoise(flat, rows, observed.device)

        def noise() -> Tensor:
            return source.draw(configuration.values).to(observed.dtype).unflatten(0, (-1, samples))

        kept = None
        if configuration.condition_kept_sampling < 1.0:
            # A stream beside that of the sample's noise, which stays as it is whatever share keeps the condition.
            draws = [sequence_generator(seed).spawn(1)[0].random() for seed in flat]
            chosen = torch.tensor(draws, device=observed.device) < configuration.condition_kept_sampling
            kept = chosen.unflatten(0, (-1, samples))
        known = self.transform(padded(observed, configuration.frames, gaze_valid))
        condition = self.condition(known)
        offset = torch.zeros_like(known)
        if self.configuration.residual:
            offset = known
        *_, state = self.states(known - offset, condition, noise, kept)
        if self.whitening is not None:
            state = self.whitening.inverse(state)
        final = state + offset[:, None]
        return self.transform.inverse(final)[:, :, configuration.observed :]

    @torch.no_grad()
    def residuals(
        self, motion: Float[Tensor, "windows frames nodes 3"]
    ) -> Float[Tensor, "windows coefficients values"]:
        """Coefficients of the difference of whole windows to their padded observation, metres."""
        known = padded(motion[:, : self.configuration.observed], motion.shape[1])
        return self.transform(motion) - self.transform(known)

    @torch.no_grad()
    def states(
        self,
        known: Float[Tensor, "windows coefficients values"],
        condition: Float[Tensor, "windows coefficients values"],
        noise: _Noise,
        kept: Bool[Tensor, "windows samples"] | None = None,
    ) -> Iterator[Float[Tensor, "windows samples coefficients values"]]:
        """Walk from noise to clean coefficients by DDIM (η = 0), completed by the observation after every step.

        Args:
            known: Coefficients of the padded observation, not whitened; zeros if residuals are diffused.
            condition: What :meth:`condition` has made of them.
            noise: Called once for the start and once a step, the noisiest first.
            kept: Which samples keep the condition vector; None if all do.

        Yields:
            The state after each step.
        """
        prepared = self.denoiser.prepare(condition, kept)
        guidance = self.configuration.guidance
        without = None
        if guidance != 1.0:
            without = self._prepared(condition, torch.zeros(len(condition), dtype=torch.bool, device=condition.device))
        state = noise()
        for step, level, cleaner in self.moves():
            index = torch.full((1,), step, device=state.device)
            predicted = self.denoiser(state, index, prepared)
            if without is not None:
                predicted = torch.lerp(self.denoiser(state, index, without), predicted, guidance)
            if self.configuration.predicts == "velocity":
                predicted = math.sqrt(level) * predicted + math.sqrt(1.0 - level) * state
            # √ᾱ' x0 + √(1 - ᾱ') ε with x0 = (x - √(1 - ᾱ) ε) / √ᾱ, collected by x and ε in float64.
            of_state = math.sqrt(cleaner / level)
            of_noise = math.sqrt(1.0 - cleaner) - of_state * math.sqrt(1.0 - level)
            state = of_state * state + of_noise * predicted
            state = self._completed(state, math.sqrt(cleaner) * known[:, None], math.sqrt(1.0 - cleaner) * noise())
            yield state

    def _completed(
        self,
        state: Float[Tensor, "windows samples coefficients values"],
        known: Float[Tensor, "windows #samples coefficients values"],
        noise: Float[Tensor, "windows samples coefficients values"],
    ) -> Float[Tensor, "windows samples coefficients values"]:
        """Put back the observed frames, as noisy as the state is."""
        if self.whitening is None:
            return self.transform.completed(state, known + noise)
        # Which frames are known is a matter of metres.
        noisy_known = known + self.whitening.inverse(noise)
        return self.whitening(self.transform.completed(self.whitening.inverse(state), noisy_known))

    def moves(self) -> Iterator[tuple[int, float, float]]:
        """Each step, the noisiest first: its index, ᾱ there, and ᾱ of the index that it leads to.

        Steps are 1, 1 + stride, …; the last one leads to index 0, which is not quite free of noise.
        """
        levels = self.schedule.alphas_cumprod
        stride = len(levels) // self.configuration.sampling_steps
        steps = list(range(1, len(levels), stride))
        for step, previous in zip(reversed(steps), [*reversed(steps[:-1]), 0], strict=True):
            yield step, float(levels[step]), float(levels[previous])

    def _prepared(self, condition: Tensor, kept: Bool[Tensor, " windows"] | None) -> PreparedCondition:
        """The condition, and for windows that do not keep it what is left of it."""
        if kept is not None and self.configuration.dropped == "both":
            condition = condition * kept[:, None, None]
        return self.denoiser.prepare(condition, None if kept is None else kept[:, None])
