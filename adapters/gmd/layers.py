"""Blocks of the one-dimensional U-Nets; everything is (batch, channels, frames)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from prbench_adapters.gmd.configuration import GROUPS

_KERNEL = 5


class ConvBlock(nn.Module):
    """Convolution, group normalisation, Mish; with a scale and shift before the last if they are given."""

    def __init__(self, channels: int, width: int, *, starts_at_zero: bool = False) -> None:
        super().__init__()
        self.convolution = nn.Conv1d(channels, width, _KERNEL, padding=_KERNEL // 2)
        self.norm = nn.GroupNorm(GROUPS, width)
        if starts_at_zero:
            nn.init.zeros_(self.convolution.weight)
            nn.init.zeros_(_bias(self.convolution))

    def forward(
        self,
        stream: Float[Tensor, "batch channels frames"],
        scale_shift: tuple[Tensor, Tensor] | None = None,
    ) -> Float[Tensor, "batch width frames"]:
        """Apply the block; ``scale_shift`` are (batch, width) each."""
        stream = self.norm(self.convolution(stream))
        if scale_shift is not None:
            scale, shift = scale_shift
            stream = stream * (1 + scale[..., None]) + shift[..., None]
        return nn.functional.mish(stream)


class ResidualBlock(nn.Module):
    """Two convolution blocks beside a skip; the condition scales and shifts the first.

    The condition's layer and the second convolution start at zero.
    """

    def __init__(self, channels: int, width: int, condition_width: int) -> None:
        super().__init__()
        self.first = ConvBlock(channels, width)
        self.condition = nn.Linear(condition_width, 2 * width)
        nn.init.zeros_(self.condition.weight)
        nn.init.zeros_(self.condition.bias)
        self.second = ConvBlock(width, width, starts_at_zero=True)
        self.skip = nn.Conv1d(channels, width, 1) if channels != width else nn.Identity()

    def forward(
        self, stream: Float[Tensor, "batch channels frames"], condition: Float[Tensor, "batch size"]
    ) -> Float[Tensor, "batch width frames"]:
        """Apply the block; ``condition`` is the vector of step and text."""
        scale, shift = self.condition(nn.functional.mish(condition)).chunk(2, dim=1)
        return self.second(self.first(stream, (scale, shift))) + self.skip(stream)


class Level(nn.Module):
    """Two residual blocks, and a change of resolution after them."""

    def __init__(self, channels: int, width: int, condition_width: int, resample: nn.Module) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(
            (ResidualBlock(channels, width, condition_width), ResidualBlock(width, width, condition_width))
        )
        self.resample = resample

    def forward(
        self, stream: Float[Tensor, "batch channels frames"], condition: Float[Tensor, "batch size"]
    ) -> tuple[Float[Tensor, "batch width frames"], Float[Tensor, "batch width others"]]:
        """The stream before and after the change of resolution."""
        for block in self.blocks:
            stream = block(stream, condition)
        return stream, self.resample(stream)


def halved(width: int) -> nn.Module:
    """Half as many frames."""
    return nn.Conv1d(width, width, 3, stride=2, padding=1)


def doubled(width: int) -> nn.Module:
    """Twice as many frames."""
    return nn.ConvTranspose1d(width, width, 4, stride=2, padding=1)


def _bias(convolution: nn.Conv1d) -> torch.Tensor:
    assert convolution.bias is not None
    return convolution.bias
