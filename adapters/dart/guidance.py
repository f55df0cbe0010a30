"""Latents of primitives from noise, with classifier-free guidance by the text."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from prbench_adapters.dart.configuration import HISTORY_FRAMES
from prbench_adapters.dart.networks import LatentDenoiser
from prbench_adapters.dart.rollout import SampleLatent
from prbench_adapters.diffusion.generation import Guidance
from prbench_adapters.diffusion.layers import TransformerLayer
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim, sample_ddpm

_CONTEXT = slice(1, 2 + HISTORY_FRAMES)  # places of text and history among the tokens
_LATENT = 2 + HISTORY_FRAMES


class PreparedDenoiser:
    """Computes :class:`LatentDenoiser` up to rounding, with gradients, in about three quarters of the time.

    Only the last token changes within a primitive, besides the one for the step: the others are embedded, and projected
    for the first layer's attention, once. Only the last token is read, so the last layer has no other queries.

    Args:
        denoiser: In evaluation mode.
        text: One vector each; zeros for no text.
        history: Standardised features.
    """

    def __init__(
        self,
        denoiser: LatentDenoiser,
        text: Float[Tensor, "batch dimension"],
        history: Float[Tensor, "batch history 276"],
    ) -> None:
        self.denoiser, self.places = denoiser, denoiser.sinusoid
        self.layers = cast(list[TransformerLayer], list(denoiser.layers))
        self.project = self.layers[0].self_attention.query_key_value
        context = (denoiser.text_embedding(text)[:, None], denoiser.history_embedding(history))
        self.context = torch.cat(context, dim=1) + self.places[_CONTEXT]
        times = self.places[: denoiser.configuration.diffusion_steps]
        self.times = denoiser.time_embedding(times) + self.places[0]
        self.projected_context, self.projected_times = self.project(self.context), self.project(self.times)

    def __call__(self, noisy: Float[Tensor, "batch 1 latent"], step: int) -> Float[Tensor, "batch 1 latent"]:
        """The clean latent from a noisy one at a diffusion step."""
        rows = len(noisy)
        latent = self.denoiser.latent_embedding(noisy[:, 0]) + self.places[_LATENT]
        stream = _tokens(self.times[step], self.context, latent)
        projected = _tokens(self.projected_times[step], self.projected_context, self.project(latent))
        # TransformerLayer written out without dropout: the layers' own forward would compute all tokens anew.
        for number, layer in enumerate(self.layers):
            if number:
                projected = layer.self_attention.query_key_value(stream)
            of_heads = projected.view(rows, _LATENT + 1, 3, layer.self_attention.heads, -1)
            query, key, value = of_heads.permute(2, 0, 3, 1, 4).unbind()
            # Nobody reads the other tokens behind the last layer.
            if number == len(self.layers) - 1:
                query = query[:, :, -1:]
                stream = stream.view(rows, _LATENT + 1, -1)[:, -1]
            looked = functional.scaled_dot_product_attention(query, key, value).transpose(1, 2).reshape(stream.shape)
            stream = layer.self_attention_norm(stream + layer.self_attention.output(looked))
            hidden = functional.gelu(layer.feed_forward.expand(stream))
            stream = layer.feed_forward_norm(stream + layer.feed_forward.contract(hidden))
        return self.denoiser.head(stream)[:, None]


def _tokens(
    time: Float[Tensor, " width"],
    context: Float[Tensor, "batch context width"],
    latent: Float[Tensor, "batch width"],
) -> Float[Tensor, "rows width"]:
    """All tokens of all rows below each other: linear layers take a matrix quicker than a stack of them."""
    return torch.cat((time.expand(len(latent), 1, -1), context, latent[:, None]), dim=1).flatten(0, 1)


class GuidedDenoiser(Guidance):
    """A denoiser under B texts.

    Args:
        denoiser: Of latents, in evaluation mode.
        text: One vector each.
        scale: Of the guidance; 1 is the conditional estimate alone, in one pass, anything else takes two.
    """

    def __init__(self, denoiser: LatentDenoiser, text: Float[Tensor, "batch dimension"], scale: float) -> None:
        super().__init__(scale)
        self.denoiser, self.text = denoiser, text

    def under(self, history: Float[Tensor, "batch history 276"]) -> Callable[[Tensor, int], Tensor]:
        """The guided estimate of clean latents as the samplers take it: of noisy latents and diffusion step.

        Where there are fewer histories than texts, they are those of the first motions.
        """
        # Rows stand longest first, so the sequences that go on are always the first rows.
        text = self.text[: len(history)]
        texts = self.both(text, torch.zeros_like(text))
        prepared = PreparedDenoiser(self.denoiser, texts, self.both(history, history))
        return lambda noisy, step: self.estimate(lambda rows: prepared(rows, step), noisy)


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
