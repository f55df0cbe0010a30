"""The two networks of DART: the autoencoder of primitives and the denoiser of their latents.

Source: docs/specification/dart.md#networks.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from prbench_adapters.dart.configuration import HISTORY_FRAMES, DartConfiguration
from prbench_adapters.dart.frames import N_FEATURES
from prbench_adapters.diffusion.layers import TransformerLayer, sinusoid_table

_LARGEST_LOG_VARIANCE = 10.0
_SPREAD = 0.02  # of learned tokens and positions before the first step


class _SkipTransformer(nn.Module):
    """A transformer encoder whose later layers also see what the earlier ones gave, as in a U-Net."""

    def __init__(self, width: int, heads: int, feed_forward: int, layers: int, dropout: float) -> None:
        super().__init__()
        around = range(layers // 2)

        def layer() -> TransformerLayer:
            return TransformerLayer(width, heads, feed_forward, dropout, cross_attention=False)

        self.input_layers = nn.ModuleList(layer() for _ in around)
        self.middle_layer = layer()
        self.output_layers = nn.ModuleList(layer() for _ in around)
        self.joins = nn.ModuleList(nn.Linear(2 * width, width) for _ in around)
        self.norm = nn.LayerNorm(width)

    def forward(self, stream: Float[Tensor, "batch tokens width"]) -> Float[Tensor, "batch tokens width"]:
        """All tokens look at all."""
        seen = []
        for layer in self.input_layers:
            stream = layer(stream, None, None, None)
            seen.append(stream)
        stream = self.middle_layer(stream, None, None, None)
        for layer, join in zip(self.output_layers, self.joins, strict=True):
            stream = layer(join(torch.cat((stream, seen.pop()), dim=-1)), None, None, None)
        return self.norm(stream)


class PrimitiveVAE(nn.Module):
    """A latent vector from the frames of a primitive, and its future frames from latent and history."""

    def __init__(self, configuration: DartConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.vae_width
        frames = configuration.primitive_frames
        sizes = (width, configuration.vae_heads, configuration.vae_feed_forward, configuration.vae_layers)
        self.frame_embedding = nn.Linear(N_FEATURES, width)
        self.distribution_tokens = nn.Parameter(torch.randn(2, width) * _SPREAD)
        self.encoder_positions = nn.Parameter(torch.randn(2 + frames, width) * _SPREAD)
        self.encoder = _SkipTransformer(*sizes, configuration.dropout)
        self.encoder_head = nn.Linear(width, configuration.latent)
        self.latent_embedding = nn.Linear(configuration.latent, width)
        self.decoder_positions = nn.Parameter(torch.randn(1 + frames, width) * _SPREAD)
        self.decoder = _SkipTransformer(*sizes, configuration.dropout)
        self.decoder_head = nn.Linear(width, N_FEATURES)

    def encode(
        self, history: Float[Tensor, "batch history 276"], future: Float[Tensor, "batch future 276"]
    ) -> tuple[Float[Tensor, "batch 1 latent"], Float[Tensor, "batch 1 latent"]]:
        """Mean and logarithm of the variance of the latent; features are standardised."""
        frames = self.frame_embedding(torch.cat((history, future), dim=1))
        tokens = torch.cat((self.distribution_tokens.expand(len(frames), -1, -1), frames), dim=1)
        # The two tokens in front are read, one for the mean and one for the variance.
        found = self.encoder_head(self.encoder(tokens + self.encoder_positions)[:, :2])
        return found[:, :1], found[:, 1:].clamp(-_LARGEST_LOG_VARIANCE, _LARGEST_LOG_VARIANCE)

    def decode(
        self, latent: Float[Tensor, "batch 1 latent"], history: Float[Tensor, "batch history 276"]
    ) -> Float[Tensor, "batch future 276"]:
        """Standardised features of the future frames; the latent as :meth:`encode` gives it, not divided by its std."""
        embedded = (self.latent_embedding(latent), self.frame_embedding(history))
        # Frames to come have no content of their own: their position says which one each query asks for.
        queries = embedded[0].new_zeros(len(latent), self.configuration.future_frames, self.configuration.vae_width)
        stream = self.decoder(torch.cat((*embedded, queries), dim=1) + self.decoder_positions)
        return self.decoder_head(stream[:, -self.configuration.future_frames :])


class LatentDenoiser(nn.Module):
    """The clean latent from a noisy one, its diffusion step, a text and the history."""

    def __init__(self, configuration: DartConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.width
        self.time_embedding = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.text_embedding = nn.Linear(configuration.text_dimension, width)
        self.history_embedding = nn.Linear(N_FEATURES, width)
        self.latent_embedding = nn.Linear(configuration.latent, width)
        self.layers = nn.ModuleList(
            TransformerLayer(
                width, configuration.heads, configuration.feed_forward, configuration.dropout, cross_attention=False
            )
            for _ in range(configuration.layers)
        )
        self.head = nn.Linear(width, configuration.latent)
        self.dropout = nn.Dropout(configuration.dropout)
        self.sinusoid: Tensor
        rows = max(configuration.diffusion_steps, 3 + HISTORY_FRAMES)
        self.register_buffer("sinusoid", sinusoid_table(rows, width), persistent=False)

    def forward(
        self,
        noisy: Float[Tensor, "batch 1 latent"],
        step: Int[Tensor, " batch"],
        text: Float[Tensor, "batch dimension"],
        history: Float[Tensor, "batch history 276"],
    ) -> Float[Tensor, "batch 1 latent"]:
        """The clean latent, divided by its std as the noisy one is.

        Args:
            noisy: Noisy latents.
            step: Index of the diffusion step of each.
            text: One vector each; zeros for no text.
            history: Standardised features.
        """
        tokens = (
            self.time_embedding(self.sinusoid[step])[:, None],
            self.text_embedding(text)[:, None],
            self.history_embedding(history),
            self.latent_embedding(noisy),
        )
        stream = torch.cat(tokens, dim=1)
        stream = self.dropout(stream + self.sinusoid[: stream.shape[1]])
        for layer in self.layers:
            stream = layer(stream, None, None, None)
        return self.head(stream[:, -1:])
