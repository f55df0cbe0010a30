"""The U-Net that BeLFusion's diffusion of behaviours is made of: a latent vector seen as a small image.

Source: docs/specification/prediction-baselines.md#belfusion.
"""

from __future__ import annotations

from typing import Literal, TypeVar

import msgspec
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench_adapters.diffusion.layers import sinusoid_table

_GROUPS = 32
_Resize = Literal["none", "halve", "double"]
_Layer = TypeVar("_Layer", bound=nn.Module)


class UNetConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the U-Net.

    Raises:
        ValueError: for sizes that do not fit together.
    """

    height: int = 16
    width: int = 8
    channels: int = 32
    multiples: tuple[int, ...] = (1, 2, 4, 8)
    """Channels of each level, in ``channels``; every further level halves height and width."""
    attention_at: tuple[int, ...] = (4, 8)
    """Reductions of the resolution at which blocks are followed by attention."""
    head_channels: int = 16
    condition: int = 64
    """Numbers of the code of the past."""
    steps: int = 10

    def __post_init__(self) -> None:
        if self.channels < 1 or self.channels % _GROUPS or not self.multiples or min(self.multiples) < 1:
            raise ValueError(
                f"'channels' must be a multiple of {_GROUPS} and 'multiples' positive, found {self.channels} and"
                f" {list(self.multiples)}"
            )
        stride = 2 ** (len(self.multiples) - 1)
        if min(self.height, self.width) < 1 or self.height % stride or self.width % stride:
            raise ValueError(
                f"'height' and 'width' must be multiples of {stride}, because the levels halve them, found"
                f" {self.height} and {self.width}"
            )
        if self.head_channels < 1 or self.channels % self.head_channels:
            raise ValueError(f"'head_channels' must divide {self.channels} channels, found {self.head_channels}")
        if self.condition < 1 or self.steps < 1:
            raise ValueError(f"'condition' and 'steps' must be at least 1, found {self.condition} and {self.steps}")

    @property
    def latent(self) -> int:
        """Numbers of the latent vector."""
        return self.height * self.width

    @property
    def embedding(self) -> int:
        """Numbers of the vector of step and condition."""
        return 4 * self.channels + self.condition


class LatentUNet(nn.Module):
    """Predicts the clean latent vector from a noisy one, the step and the code of the past.

    Args:
        configuration: Sizes.
    """

    def __init__(self, configuration: UNetConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        channels = configuration.channels
        time = 4 * channels
        self.time = nn.Sequential(nn.Linear(channels, time), nn.SiLU(), nn.Linear(time, time))
        self.input = nn.Conv2d(1, channels, 3, padding=1)
        widths = [channels * multiple for multiple in configuration.multiples]
        embedding = configuration.embedding
        last = len(widths) - 1
        skips, inputs = [channels], channels
        self.down = nn.ModuleList()
        for level, width in enumerate(widths):
            self.down.append(nn.ModuleList([_Block(inputs, width, embedding), *self._attention(level, width)]))
            skips.append(width)
            if level < last:
                self.down.append(nn.ModuleList([_Block(width, width, embedding, "halve")]))
                skips.append(width)
            inputs = width
        self.middle = nn.ModuleList(
            [
                _Block(inputs, inputs, embedding),
                _Attention(inputs, configuration.head_channels),
                _Block(inputs, inputs, embedding),
            ]
        )
        self.up = nn.ModuleList()
        for level, width in reversed(list(enumerate(widths))):
            # A level has as many blocks on the way up as outputs on the way down: its own, and that of the change.
            for place in range(2):
                stage = [_Block(inputs + skips.pop(), width, embedding), *self._attention(level, width)]
                if place and level:
                    stage.append(_Block(width, width, embedding, "double"))
                self.up.append(nn.ModuleList(stage))
                inputs = width
        self.output = nn.Sequential(
            nn.GroupNorm(_GROUPS, inputs), nn.SiLU(), _from_zero(nn.Conv2d(inputs, 1, 3, padding=1))
        )
        table = sinusoid_table(configuration.steps, channels)
        self.register_buffer("sinusoid", torch.cat([table[:, 1::2], table[:, ::2]], dim=1), persistent=False)
        self.sinusoid: Tensor

    def forward(
        self,
        noisy: Float[Tensor, "batch latent"],
        step: Int[Tensor, " batch"],
        condition: Float[Tensor, "batch condition"],
    ) -> Float[Tensor, "batch latent"]:
        """Predict; ``step`` is the index in the training schedule."""
        embedding = functional.silu(torch.cat([self.time(self.sinusoid[step]), condition], dim=1))
        shape = self.configuration
        stream = self.input(noisy.view(-1, 1, shape.height, shape.width))
        skips = [stream]
        for stage in self.down:
            stream = _through(stage, stream, embedding)
            skips.append(stream)
        stream = _through(self.middle, stream, embedding)
        for stage in self.up:
            stream = _through(stage, torch.cat([stream, skips.pop()], dim=1), embedding)
        return self.output(stream).flatten(1)

    def _attention(self, level: int, width: int) -> list[nn.Module]:
        if 2**level not in self.configuration.attention_at:
            return []
        return [_Attention(width, self.configuration.head_channels)]


def _through(stage: nn.Module, stream: Tensor, embedding: Tensor) -> Tensor:
    for part in stage.children():
        stream = part(stream, embedding)
    return stream


class _Block(nn.Module):
    """Two convolutions beside a skip; step and condition scale and shift what stands between them."""

    def __init__(self, inputs: int, outputs: int, embedding: int, resize: _Resize = "none") -> None:
        super().__init__()
        self.resize = resize
        self.first_norm = nn.GroupNorm(_GROUPS, inputs)
        self.first = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.scale_shift = nn.Linear(embedding, 2 * outputs)
        self.second_norm = nn.GroupNorm(_GROUPS, outputs)
        self.second = _from_zero(nn.Conv2d(outputs, outputs, 3, padding=1))
        self.skip = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(
        self, stream: Float[Tensor, "batch inputs height width"], embedding: Float[Tensor, "batch embedding"]
    ) -> Float[Tensor, "batch outputs new_height new_width"]:
        hidden = self.first(self._resized(functional.silu(self.first_norm(stream))))
        scale, shift = self.scale_shift(embedding)[:, :, None, None].chunk(2, dim=1)
        hidden = torch.addcmul(shift, self.second_norm(hidden), 1 + scale)
        return self.skip(self._resized(stream)) + self.second(functional.silu(hidden))

    def _resized(self, stream: Tensor) -> Tensor:
        if self.resize == "halve":
            return functional.avg_pool2d(stream, 2)
        if self.resize == "double":
            return functional.interpolate(stream, scale_factor=2, mode="nearest")
        return stream


class _Attention(nn.Module):
    """Self-attention of all places of the image, residual."""

    def __init__(self, channels: int, head_channels: int) -> None:
        super().__init__()
        self.heads = channels // head_channels
        self.norm = nn.GroupNorm(_GROUPS, channels)
        self.query_key_value = nn.Conv1d(channels, 3 * channels, 1)
        self.output = _from_zero(nn.Conv1d(channels, channels, 1))

    def forward(
        self,
        stream: Float[Tensor, "batch channels height width"],
        embedding: Float[Tensor, "batch embedding"],  # noqa: ARG002 - called like a block
    ) -> Float[Tensor, "batch channels height width"]:
        """Let each place of the stream look at all others; the embedding of the diffusion step has no part in it."""
        places = self.query_key_value(self.norm(stream).flatten(2))
        query, key, value = places.unflatten(1, (3, self.heads, -1)).movedim(1, 0).transpose(-1, -2)
        attended = functional.scaled_dot_product_attention(query, key, value)
        return stream + self.output(attended.transpose(-1, -2).flatten(1, 2)).view_as(stream)


def _from_zero(layer: _Layer) -> _Layer:
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer
