"""Parts of the solver of noise optimisation: Adam, its learning rate, and the decorrelation loss.

Sources: docs/specification/dno.md#the-optimiser, docs/specification/dno.md#decorrelation-loss.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.randomness import named_generator

_BETAS = (0.9, 0.999)
_EPSILON = 1e-8
_SHORTEST_GRADIENT = 1e-12

Noise = Float[torch.Tensor, "batch frames features"]


@dataclass(frozen=True)
class AdamState:
    """Moments of the gradients of each row's noise; all rows have done the same number of steps."""

    first: Noise
    second: Noise
    steps: int = 0

    @classmethod
    def start(cls, noise: Noise) -> AdamState:
        """Moments before the first step."""
        return cls(torch.zeros_like(noise), torch.zeros_like(noise))

    def rows(self, index: Int[torch.Tensor, " kept"]) -> AdamState:
        """The moments of some of the rows."""
        return AdamState(self.first[index], self.second[index], self.steps)

    def stepped(self, noise: Noise, gradient: Noise, learning_rate: float) -> tuple[Noise, AdamState]:
        """The noise after one step with default betas, and the moments that belong to it."""
        first = self.first.lerp(gradient, 1.0 - _BETAS[0])
        second = self.second * _BETAS[1] + gradient.square() * (1.0 - _BETAS[1])
        steps = self.steps + 1
        scale = second.sqrt() / (1.0 - _BETAS[1] ** steps) ** 0.5 + _EPSILON
        # Adam written out: torch's own keeps one state for a tensor, from which no finished row can be taken out.
        moved = noise - learning_rate / (1.0 - _BETAS[0] ** steps) * first / scale
        return moved, AdamState(first, second, steps)


def unit_gradient(gradient: Noise) -> tuple[Noise, Float[torch.Tensor, " batch"]]:
    """Each row's gradient at length 1 over frames and features, and the lengths that they had.

    A zero gradient stays zero: the divisor is at least 1e-12.
    """
    lengths = gradient.flatten(1).norm(dim=1)
    return gradient / lengths.clamp_min(_SHORTEST_GRADIENT)[:, None, None], lengths


def learning_rate_factor(step: int, *, warmup: int, iterations: int) -> float:
    """Factor on the learning rate at ``step``, from 0 to 1.

    The warm-up is ``step / warmup`` and starts at 0, so that the first step of the published schedule moves nothing;
    the cosine decays over the whole run and is 0 at ``step = iterations``.

    Args:
        step: Iterations done so far.
        warmup: Iterations of the warm-up; 0 switches it off.
        iterations: Iterations of the whole run.
    """
    ramp = step / warmup if step < warmup else 1.0
    return ramp * (math.cos(math.pi * step / iterations) + 1.0) / 2.0


def decorrelation(noise: Float[torch.Tensor, "batch frames features"]) -> Float[torch.Tensor, " batch"]:
    """Squared correlation of neighbouring frames, summed over a pyramid of averaged frames.

    At each size from ``frames`` down to 2: the mean over frames and features of z_t z_(t-1), cyclic in time, squared;
    then neighbouring pairs of frames are averaged.

    Args:
        noise: The number of frames must be a power of two; see :class:`DecorrelationPadding`.
    """
    total = noise.new_zeros(len(noise))
    while noise.shape[1] >= 2:
        # Cyclic as in the original: the last frame also neighbours the first.
        total = total + (noise * noise.roll(1, dims=1)).mean(dim=(1, 2)) ** 2
        noise = noise.unflatten(1, (-1, 2)).mean(dim=2)
    return total


class DecorrelationPadding:
    """Fills noise of any length up to the next power of two with fresh normal numbers, and takes the loss there.

    Each sequence draws from a stream of its own, made of its seed, so that neither the order nor the size of the batch
    changes what is drawn. Lengths that are a power of two are not padded.
    """

    def __init__(self, seeds: Sequence[int], n_frames: Int[torch.Tensor, " batch"]) -> None:
        self._lengths = [int(length) for length in n_frames]
        self._generators = [named_generator("prbench-decorrelation", seed) for seed in seeds]

    def rows(self, kept: Sequence[int]) -> DecorrelationPadding:
        """Hand on the streams of some of the sequences, where they stand now."""
        part = DecorrelationPadding((), torch.zeros(0, dtype=torch.int64))
        part._lengths = [self._lengths[row] for row in kept]
        part._generators = [self._generators[row] for row in kept]
        return part

    def loss(self, noise: Float[torch.Tensor, "batch frames features"]) -> Float[torch.Tensor, " batch"]:
        """Decorrelation loss of each sequence's own frames; what lies behind them leaves no trace."""
        sizes = np.array([power_of_two_above(length) for length in self._lengths])
        total = noise.new_zeros(len(noise))
        for size in np.unique(sizes):
            rows = np.flatnonzero(sizes == size)
            index = torch.as_tensor(rows, device=noise.device)
            total = total.index_put((index,), decorrelation(self._padded(noise, rows, int(size))))
        return total

    def _padded(self, noise: torch.Tensor, rows: np.ndarray, size: int) -> torch.Tensor:
        filling = np.zeros((len(rows), size, noise.shape[2]), dtype=np.float32)
        for place, row in enumerate(rows):
            tail = filling[place, self._lengths[row] :]
            tail[:] = self._generators[row].standard_normal(tail.shape, dtype=np.float32)
        shape = (len(rows), size, 1)
        own = torch.as_tensor(np.arange(size) < np.take(self._lengths, rows)[:, None]).reshape(shape)
        given = noise[torch.as_tensor(rows, device=noise.device), :size]
        given = torch.nn.functional.pad(given, (0, 0, 0, size - given.shape[1]))
        return torch.where(own.to(noise.device), given, torch.as_tensor(filling).to(noise))


def power_of_two_above(length: int) -> int:
    """The smallest power of two that is not below ``length``."""
    return 1 << max(length - 1, 0).bit_length()
