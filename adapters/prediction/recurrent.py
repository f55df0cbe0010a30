"""What the recurrent predictors share: small perceptrons, and the state that a sequence leaves in a recurrent layer.

Source: docs/specification/prediction-baselines.md#common.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from prbench.randomness import sequence_generator


class Perceptron(nn.Sequential):
    """Linear layers with a tanh behind each, the last one too."""

    def __init__(self, sizes: Sequence[int]) -> None:
        super().__init__(*(layer for ends in pairwise(sizes) for layer in (nn.Linear(*ends), nn.Tanh())))


def last_state(layer: nn.GRU | nn.LSTM, sequence: Float[Tensor, "batch frames size"]) -> Float[Tensor, "batch state"]:
    """The state that a sequence leaves in a recurrent layer; batch first."""
    return layer(sequence)[0][:, -1]


class PoseDecoder(nn.Module):
    """Poses one after another: each depends on a code, the pose before it, and the state of a recurrent cell.

    Args:
        code: Numbers that stay the same over all frames.
        start: Numbers that the first state is made of.
        state: Width of the cell.
        mlp: Widths of the perceptrons before the first state and before the pose.
        values: Numbers of a pose.
    """

    def __init__(self, code: int, start: int, state: int, mlp: Sequence[int], values: int) -> None:
        super().__init__()
        self.first_state = Perceptron([start, *mlp, state])
        self.cell = nn.GRUCell(code + values, state)
        self.mlp = Perceptron([state, *mlp])
        self.output = nn.Linear(mlp[-1], values)

    def forward(
        self,
        code: Float[Tensor, "batch code"],
        start: Float[Tensor, "batch start"],
        pose: Float[Tensor, "batch values"],
        frames: int,
    ) -> Float[Tensor, "batch frames values"]:
        """Outputs of ``frames`` frames; ``pose`` is what stands before the first."""
        state = self.first_state(start)
        poses = []
        for _ in range(frames):
            state = self.cell(torch.cat([code, pose], dim=1), state)
            pose = self.output(self.mlp(state))
            poses.append(pose)
        return torch.stack(poses, dim=1)


def latent_noise(seeds: Sequence[Sequence[int]], size: int, like: Tensor) -> Float[Tensor, "windows samples size"]:
    """Standard normal noise, each sample's from its own seed and nothing else.

    Args:
        seeds: One for each sample of each window.
        size: Numbers of a latent vector.
        like: Tensor whose type and device the noise gets.
    """
    draws = [[sequence_generator(seed).standard_normal(size, dtype=np.float32) for seed in row] for row in seeds]
    return torch.from_numpy(np.array(draws)).to(like)


def gaussian_kl(
    mean: Float[Tensor, "*batch size"], log_variance: Float[Tensor, "*batch size"]
) -> Float[Tensor, "*batch"]:
    """Kullback-Leibler divergence of a diagonal Gaussian from the standard one, nats."""
    return -0.5 * (1.0 + log_variance - mean.square() - log_variance.exp()).sum(dim=-1)
