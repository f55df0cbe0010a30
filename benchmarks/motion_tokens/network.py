"""The VQ-VAE of motion tokens, part by part as MotionGPT's program has it (docs/specification/motion-tokens.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import msgspec
import torch
from jaxtyping import Float, Int
from torch import nn

from prbench.representation import N_FEATURES
from prbench_adapters.training.configuration import require_within

FRAMES_OF_TOKEN = 4
_DILATIONS = (9, 3, 1)
_DECAY = 0.99  # of the running sum and count of each code
_FEWEST = 1.0  # a code with a smaller running count is replaced
_NOISE = 0.01  # divided by the root of the width: keeps the copies of a vector apart

Vectors = Float[torch.Tensor, "vectors width"]
Features = Float[torch.Tensor, "batch frames 263"]


class TokeniserConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the networks and codebooks, and the features that they read.

    Attributes:
        width: Channels of the convolutions.
        latent: Channels of the encoder's output, over all parts.
        codes: Codes of each part's codebook.
        parts: Equal parts of the channels, 1 or 2, each with a codebook of its own (product quantisation).
        representation: Mode of the representation.
        fps: Frame rate of the motions, in frames per second.
        max_frames: The longest motion that is trained on.
    """

    width: int = 512
    latent: int = 512
    codes: int = 512
    parts: int = 1
    representation: Literal["continuous", "reference"] = "continuous"
    fps: float = 20.0
    max_frames: int = 240

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "width", "latent", "codes", "max_frames")
        require_within(self, "above 0", "fps")
        if self.parts not in (1, 2) or self.latent % self.parts:
            found = f"found {self.parts} parts of {self.latent} channels"
            raise ValueError(f"`parts` must be 1 or 2, and `latent` a multiple of it, {found}")


@dataclass(frozen=True)
class Quantised:
    """What quantisers made of a batch of vectors.

    Attributes:
        vectors: The codes in the vectors' place; the gradient goes to the vectors as if they were not replaced.
        tokens: Number of each part's code.
        commitment: Mean squared distance of the vectors from their codes; the mean over parts.
        perplexity: exp(−Σ p log(p + 1e-7)) of the shares p of the codes; the mean over parts.
    """

    vectors: Vectors
    tokens: Int[torch.Tensor, "vectors parts"]
    commitment: Float[torch.Tensor, ""]
    perplexity: Float[torch.Tensor, ""]


class Quantiser(nn.Module):
    """A codebook that follows the running mean of the vectors nearest to each code.

    Codes, sums and counts are parameters that get no gradient: the loop keeps parameters, not buffers, as they were at
    the best validation.
    """

    def __init__(self, codes: int, width: int) -> None:
        super().__init__()
        self.codebook = nn.Parameter(torch.zeros(codes, width))
        self.sum = nn.Parameter(torch.zeros(codes, width))
        self.count = nn.Parameter(torch.zeros(codes))
        self.initialised: torch.Tensor
        self.register_buffer("initialised", torch.zeros((), dtype=torch.bool))

    def forward(self, tokens: Int[torch.Tensor, " vectors"]) -> Vectors:
        """Return the codes of tokens."""
        return self.codebook.detach()[tokens]

    def nearest(self, vectors: Vectors) -> Int[torch.Tensor, " vectors"]:
        """Return the number of the code nearest to each vector."""
        codes = self.codebook.detach()
        # The expanded square, term by term as the program has it: ties fall the same way.
        distance = vectors.square().sum(-1, keepdim=True) - 2 * vectors @ codes.T + codes.square().sum(-1)
        return distance.argmin(-1)

    @torch.no_grad()
    def initialise(self, vectors: Vectors, generator: torch.Generator | None) -> None:
        """Take the first vectors of the first batch for codes, each with a count of 1."""
        first = self._enough(vectors, generator)
        self.codebook.copy_(first)
        self.sum.copy_(first)
        self.count.fill_(1.0)
        self.initialised.fill_(True)

    @torch.no_grad()
    def update(
        self, vectors: Vectors, tokens: Int[torch.Tensor, " vectors"], generator: torch.Generator | None
    ) -> None:
        """Move each code to the running mean of its vectors; code k without enough of them becomes vector k.

        Sum and count of a replaced code stay, so it is replaced again until its count reaches 1.
        """
        chosen = torch.nn.functional.one_hot(tokens, len(self.count)).to(vectors)
        self.sum.lerp_(chosen.T @ vectors, 1 - _DECAY)
        self.count.lerp_(chosen.sum(0), 1 - _DECAY)
        used = (self.count >= _FEWEST)[:, None]
        mean = self.sum / self.count.clamp_min(_FEWEST)[:, None]
        self.codebook.copy_(torch.where(used, mean, self._enough(vectors, generator)))

    def _enough(self, vectors: Vectors, generator: torch.Generator | None) -> Vectors:
        """Return as many vectors as codes: the first ones, or all of them repeated with a little noise."""
        codes, width = self.codebook.shape
        if len(vectors) < codes:
            vectors = vectors.repeat(-(-codes // len(vectors)), 1)
            noise = torch.randn(vectors.shape, generator=generator)  # drawn on the CPU: equal on every device
            vectors = vectors + noise.to(vectors) * (_NOISE / width**0.5)
        return vectors[:codes]


class _Residual(nn.Module):
    """``x + conv1(ReLU(conv3(ReLU(x))))``; the wide convolution is dilated."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation)
        self.conv2 = nn.Conv1d(width, width, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.conv2(self.conv1(x.relu()).relu())


class Tokeniser(nn.Module):
    """Encoder, one quantiser a part, and decoder: four frames of standardised features become ``parts`` tokens.

    ``mean`` and ``std`` are the statistics of the training split.
    """

    def __init__(self, configuration: TokeniserConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.mean: torch.Tensor
        self.std: torch.Tensor
        self.register_buffer("mean", torch.zeros(N_FEATURES))
        self.register_buffer("std", torch.ones(N_FEATURES))
        width, latent, parts = configuration.width, configuration.latent, configuration.parts

        def conv(inputs: int, outputs: int) -> nn.Conv1d:
            return nn.Conv1d(inputs, outputs, 3, padding=1)

        def residuals() -> nn.Sequential:
            return nn.Sequential(*(_Residual(width, dilation) for dilation in _DILATIONS))

        def shorter() -> nn.Sequential:
            return nn.Sequential(nn.Conv1d(width, width, 4, stride=2, padding=1), residuals())

        def longer() -> nn.Sequential:
            return nn.Sequential(residuals(), nn.Upsample(scale_factor=2, mode="nearest"), conv(width, width))

        self.encoder = nn.Sequential(conv(N_FEATURES, width), nn.ReLU(), shorter(), shorter(), conv(width, latent))
        outward = (conv(width, width), nn.ReLU(), conv(width, N_FEATURES))
        self.decoder = nn.Sequential(conv(latent, width), nn.ReLU(), longer(), longer(), *outward)
        self.quantisers = nn.ModuleList(Quantiser(configuration.codes, latent // parts) for _ in range(parts))

    def encode(self, features: Features) -> Float[torch.Tensor, "batch latent tokens"]:
        """Return the encoder's output; frames must be a multiple of 4."""
        return self.encoder(features.mT)

    def quantise(
        self, encoded: Float[torch.Tensor, "batch latent tokens"], generator: torch.Generator | None = None
    ) -> Quantised:
        """Replace the encoder's output by codes; in training the codebooks follow, after the codes were taken.

        Args:
            encoded: Its vectors are taken sample by sample, in order of time.
            generator: Draws the noise where a batch has fewer vectors than there are codes.
        """
        vectors = encoded.mT.flatten(0, 1).float()
        found = []
        for quantiser, part in zip(self.quantisers, vectors.chunk(len(self.quantisers), -1)):
            assert isinstance(quantiser, Quantiser)
            fixed = part.detach()
            # In bfloat16 rounding would choose the code, and running means would hardly move.
            with torch.autocast(fixed.device.type, enabled=False):
                if self.training and not quantiser.initialised:
                    quantiser.initialise(fixed, generator)
                tokens = quantiser.nearest(fixed)
                codes = quantiser(tokens)
                if self.training:
                    quantiser.update(fixed, tokens, generator)
            shares = torch.bincount(tokens, minlength=len(quantiser.count)) / len(tokens)
            found.append((part + (codes - fixed), tokens, (part - codes).square().mean(), perplexity(shares)))
        codes, tokens, commitments, perplexities = zip(*found)
        means = (torch.stack(values).mean() for values in (commitments, perplexities))
        return Quantised(torch.cat(codes, -1), torch.stack(tokens, -1), *means)

    def decode(self, vectors: Vectors, batch: int) -> Features:
        """Return the features of a batch of motions from all their codes."""
        return self.decoder(vectors.unflatten(0, (batch, -1)).mT).mT

    def from_tokens(self, tokens: Int[torch.Tensor, "batch tokens parts"]) -> Features:
        """Return the features that tokens alone stand for."""
        flat = tokens.flatten(0, 1)
        codes = [quantiser(part) for quantiser, part in zip(self.quantisers, flat.unbind(-1))]
        return self.decode(torch.cat(codes, -1), len(tokens))

    def forward(self, features: Features, generator: torch.Generator | None = None) -> tuple[Features, Quantised]:
        """Return the reconstruction of standardised features, and their tokens."""
        quantised = self.quantise(self.encode(features), generator)
        return self.decode(quantised.vectors, len(features)), quantised


def perplexity(shares: Float[torch.Tensor, " codes"]) -> Float[torch.Tensor, ""]:
    """Return how many codes are in use: exp(−Σ p log(p + 1e-7)) of their shares p, 1 to K."""
    return (-(shares * (shares + 1e-7).log()).sum()).exp()
