"""Noise that belongs to a sequence: drawn by NumPy from its own seed, so equal on every device and in every batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.randomness import sequence_generator
from prbench.representation.features import N_FEATURES


class SequenceNoise:
    """Standard normal noise of B sequences, draw after draw.

    Args:
        noise_seed: One per sequence.
        n_frames: Frames of each sequence; padding is zero.
        device: Where the noise is wanted.
    """

    def __init__(
        self, noise_seed: Sequence[int], n_frames: Int[np.ndarray, " batch"], device: torch.device | str = "cpu"
    ) -> None:
        self._generators = [sequence_generator(seed) for seed in noise_seed]
        self._n_frames, self._device = n_frames, device

    def draw(self, columns: int = N_FEATURES) -> Float[torch.Tensor, "batch frames columns"]:
        """The next noise of every sequence; as long as the longest."""
        noise = np.zeros((len(self._n_frames), int(self._n_frames.max()), columns), dtype=np.float32)
        for row, (generator, n) in enumerate(zip(self._generators, self._n_frames, strict=True)):
            noise[row, :n] = generator.standard_normal((int(n), columns), dtype=np.float32)
        return torch.from_numpy(noise).to(self._device)


def start_noise(
    noise_seed: Sequence[int], n_frames: Int[np.ndarray, " batch"], device: torch.device | str = "cpu"
) -> Float[torch.Tensor, "batch frames 263"]:
    """The noise that sampling starts from, and that noise optimisation starts with: the first draw of each sequence."""
    return SequenceNoise(noise_seed, n_frames, device).draw()
