"""The decorrelation loss: keeps optimised noise looking like white noise.

Source: docs/specification/dno.md#decorrelation-loss.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.randomness import named_generator


def decorrelation(noise: Float[torch.Tensor, "batch frames features"]) -> Float[torch.Tensor, " batch"]:
    """Squared correlation of neighbouring frames, summed over a pyramid of averaged frames.

    At each size from ``frames`` down to 2: the mean over frames and features of z_t z_(t-1), cyclic in time, squared;
    then neighbouring pairs of frames are averaged.

    Args:
        noise: The number of frames must be a power of two; see :class:`DecorrelationPadding`.
    """
    total = noise.new_zeros(len(noise))
    while noise.shape[1] >= 2:
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
        """The same streams, where they stand now, for some of the sequences."""
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
