"""The cosine noise schedule and the chains of steps that sampling walks along; all in float64.

Source: docs/specification/mdm.md#diffusion.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

Spacing = Literal["leading", "trailing"]
"""Whether the kept steps are counted from the cleanest or from the noisiest."""

_OFFSET = 0.008
_LARGEST_BETA = 0.999


class Chain:
    """States of falling noise, from the clean side: what the steps of a sampler are computed from.

    Args:
        indices: The index of each state in the training schedule, which is what the denoiser is told.
        alphas_cumprod: ᾱ of each state.
    """

    def __init__(self, indices: Int[np.ndarray, " steps"], alphas_cumprod: Float[np.ndarray, " steps"]) -> None:
        self.indices, self.alphas_cumprod = indices, alphas_cumprod

    def __len__(self) -> int:
        return len(self.indices)

    @cached_property
    def alphas_cumprod_previous(self) -> Float[np.ndarray, " steps"]:
        """ᾱ of the next cleaner state; 1 beyond the last."""
        return np.concatenate([[1.0], self.alphas_cumprod[:-1]])

    @cached_property
    def betas(self) -> Float[np.ndarray, " steps"]:
        """Variance of the noise that leads from the next cleaner state to this one."""
        return 1.0 - self.alphas_cumprod / self.alphas_cumprod_previous

    @cached_property
    def posterior_variance(self) -> Float[np.ndarray, " steps"]:
        """β̃: the small variance, 0 at the first state."""
        return self.betas * (1.0 - self.alphas_cumprod_previous) / (1.0 - self.alphas_cumprod)

    @cached_property
    def posterior_mean_clean(self) -> Float[np.ndarray, " steps"]:
        """Factor c1 of the clean features in the posterior mean."""
        return self.betas * np.sqrt(self.alphas_cumprod_previous) / (1.0 - self.alphas_cumprod)

    @cached_property
    def posterior_mean_noisy(self) -> Float[np.ndarray, " steps"]:
        """Factor c2 of the noisy features in the posterior mean."""
        return (1.0 - self.alphas_cumprod_previous) * np.sqrt(1.0 - self.betas) / (1.0 - self.alphas_cumprod)


class CosineSchedule(Chain):
    """β_i = min(1 - f((i + 1)/T)/f(i/T), 0.999) with f(s) = cos²((s + 0.008)/1.008 · π/2).

    Args:
        n_steps: Diffusion steps T of the training.
    """

    def __init__(self, n_steps: int) -> None:
        level = [math.cos((i / n_steps + _OFFSET) / (1.0 + _OFFSET) * math.pi / 2.0) ** 2 for i in range(n_steps + 1)]
        self._betas = np.minimum(1.0 - np.array(level[1:]) / np.array(level[:-1]), _LARGEST_BETA)
        super().__init__(np.arange(n_steps), np.cumprod(1.0 - self._betas))

    @cached_property
    def betas(self) -> Float[np.ndarray, " steps"]:
        """As defined above, not re-derived from ᾱ."""
        return self._betas

    def kept_steps(self, n: int, spacing: Spacing = "leading") -> Int[np.ndarray, " n"]:
        """The indices of a chain of ``n`` steps: equal integer stride from 0 (10 of 50 are 0, 5, …, 45).

        Where no stride gives exactly ``n`` indices, they are spread as evenly as integers can be, from 0. ``trailing``
        counts from the noisiest step instead (5 of 50 are 9, 19, 29, 39, 49), so that even a short chain starts where
        the noise says nothing and the condition decides.

        Raises:
            ValueError: unless 1 ≤ n ≤ T.
        """
        total = len(self)
        if not 1 <= n <= total:
            raise ValueError(f"a schedule of {total} steps can keep 1 to {total} of them, not {n}")
        if spacing == "trailing":
            return np.arange(1, n + 1) * total // n - 1
        strided = np.arange(0, total, max(1, math.ceil(total / n)))
        return strided if len(strided) == n else np.arange(n) * total // n

    def chain(self, n: int, spacing: Spacing = "leading") -> Chain:
        """The chain of :meth:`kept_steps`; the schedule itself if all are kept."""
        kept = self.kept_steps(n, spacing)
        return self if n == len(self) else Chain(kept, self.alphas_cumprod[kept])
