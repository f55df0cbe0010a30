"""The one-dimensional U-Net over time that both stages of GMD are made of (docs/specification/gmd.md#networks)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from prbench_adapters.diffusion.layers import sinusoid_table
from prbench_adapters.gmd.configuration import GMDConfiguration
from prbench_adapters.gmd.layers import ConvBlock, Level, ResidualBlock, doubled, halved


class TemporalUNet(nn.Module):
    """Maps a noisy signal, the step and a text vector to what the network predicts: clean signal or noise.

    Args:
        channels: Of the signal: 263 for motions, 4 for trajectories.
        widths: Channels of each level, the finest first.
        configuration: Width of the condition, text and steps.
    """

    def __init__(self, channels: int, widths: Sequence[int], configuration: GMDConfiguration) -> None:
        super().__init__()
        self.channels, size = channels, configuration.condition_width
        self.time_embedding = nn.Sequential(nn.Linear(size, size), nn.SiLU(), nn.Linear(size, size))
        self.text_embedding = nn.Linear(configuration.text_dimension, size)
        self.condition = nn.Sequential(nn.Linear(size, 4 * size), nn.Mish(), nn.Linear(4 * size, size))
        levels = list(pairwise((channels, *widths)))
        self.down = nn.ModuleList(
            Level(before, width, size, halved(width) if place < len(levels) - 1 else nn.Identity())
            for place, (before, width) in enumerate(levels)
        )
        self.middle = nn.ModuleList(ResidualBlock(widths[-1], widths[-1], size) for _ in range(2))
        self.up = nn.ModuleList(
            Level(2 * width, before, size, doubled(before)) for before, width in reversed(levels[1:])
        )
        self.head = nn.Sequential(ConvBlock(widths[0], widths[0]), nn.Conv1d(widths[0], channels, 1))
        self.register_buffer("sinusoid", sinusoid_table(configuration.diffusion_steps, size), persistent=False)
        self.sinusoid: Tensor

    def forward(
        self,
        noisy: Float[Tensor, "batch frames channels"],
        step: Int[Tensor, " batch"],
        text: Float[Tensor, "batch dimension"],
        n_frames: Int[Tensor, " batch"],
        *,
        window: int,
    ) -> Float[Tensor, "batch frames channels"]:
        """Predict.

        Args:
            noisy: What stands behind ``n_frames`` leaves no trace in what stands before.
            step: Index t in the training schedule.
            text: One vector a caption; zeros for none.
            n_frames: Valid frames of each row.
            window: Frames with padding (:meth:`GMDConfiguration.window`); it changes the result.
        """
        frames = noisy.shape[1]
        valid = torch.arange(frames, device=noisy.device) < n_frames.to(noisy.device)[:, None]
        stream = noisy.masked_fill(~valid[..., None], 0.0).transpose(1, 2)
        stream = nn.functional.pad(stream, (0, window - frames))
        condition = self.condition(self.time_embedding(self.sinusoid[step]) + self.text_embedding(text))
        return self._through(stream, condition)[..., :frames].transpose(1, 2)

    def _through(
        self, stream: Float[Tensor, "batch channels window"], condition: Float[Tensor, "batch size"]
    ) -> Float[Tensor, "batch channels window"]:
        skips = []
        for level in self.down:
            skip, stream = level(stream, condition)
            skips.append(skip)
        for block in self.middle:
            stream = block(stream, condition)
        for level in self.up:
            _, stream = level(torch.cat([stream, skips.pop()], dim=1), condition)
        return self.head(stream)
