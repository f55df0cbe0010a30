"""Noise schedules, and samplers that walk along them from noise to clean features: DDPM and DDIM.

Source: docs/specification/mdm.md#diffusion.

Both samplers are differentiable from end to end. Schedules are float64 numbers of the host, applied in the dtype of the
state, so that no step waits for the device.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.checkpoint import checkpoint

# End of the schedule from which the kept steps are counted: the cleanest or the noisiest.
Spacing = Literal["leading", "trailing"]

_OFFSET = 0.008
_LARGEST_BETA = 0.999
# Deviation of the noise over that of what is left of a standardised motion, in the first and the last step: 5 % of all
# movement, and so much that the pace of a whole motion, which shows in a hundred frames at once, is hidden too.
_NOISE_RATIOS = (0.05, 30.0)
State = Float[Tensor, "batch frames features"]
# Noisy features (batch, frames, features) and their index in the training schedule, to clean features.
Denoise = Callable[[Tensor, int], Tensor]
# Index in the training schedule, to the standard normal noise (batch, frames, features) added in that step.
_DrawNoise = Callable[[int], Tensor]
# Network passes that a motion in one go may take: sampling of weights with so few steps, and nothing else.
MOST_PASSES = 16
# Index in the training schedule; factors of the clean estimate and of the state in the next state.
_Move = tuple[int, float, float]
_Factors = tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]
_Levels = Float[np.ndarray, " steps"]
_Indices = Int[np.ndarray, " steps"]


class Chain:
    """States of falling noise, from the clean side: what the steps of a sampler are computed from.

    Args:
        indices: The index of each state in the training schedule, which is what the denoiser is told.
        alphas_cumprod: ᾱ of each state.
        betas: Variance of the noise that leads from the next cleaner state to each; derived from ᾱ unless given.

    Attributes:
        alphas_cumprod_previous: ᾱ of the next cleaner state; 1 beyond the last.
        posterior_variance: β̃: the small variance, 0 at the first state.
        posterior_mean_clean: Factor c1 of the clean features in the posterior mean.
        posterior_mean_noisy: Factor c2 of the noisy features in the posterior mean.
    """

    def __init__(self, indices: _Indices, alphas_cumprod: _Levels, betas: _Levels | None = None) -> None:
        self.indices, self.alphas_cumprod = indices, alphas_cumprod
        before = np.concatenate([[1.0], alphas_cumprod[:-1]])
        self.alphas_cumprod_previous = before
        self.betas = 1.0 - alphas_cumprod / before if betas is None else betas
        self.posterior_variance = self.betas * (1.0 - before) / (1.0 - alphas_cumprod)
        self.posterior_mean_clean = self.betas * np.sqrt(before) / (1.0 - alphas_cumprod)
        self.posterior_mean_noisy = (1.0 - before) * np.sqrt(1.0 - self.betas) / (1.0 - alphas_cumprod)

    def __len__(self) -> int:
        return len(self.indices)

    def kept_steps(self, n: int, spacing: Spacing = "leading") -> Int[np.ndarray, " n"]:
        """Return the indices of a chain of ``n`` steps: equal integer stride from 0 (10 of 50 are 0, 5, …, 45).

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
        """Return the chain of :meth:`kept_steps`; the schedule itself if all are kept."""
        kept = self.kept_steps(n, spacing)
        return self if n == len(self) else Chain(kept, self.alphas_cumprod[kept])


class CosineSchedule(Chain):
    """β_i = min(1 - f((i + 1)/T)/f(i/T), 0.999) with f(s) = cos²((s + 0.008)/1.008 · π/2).

    Args:
        n_steps: Diffusion steps T of the training.
    """

    def __init__(self, n_steps: int) -> None:
        # The offset keeps the first betas from vanishing (Nichol and Dhariwal's schedule).
        level = [math.cos((i / n_steps + _OFFSET) / (1.0 + _OFFSET) * math.pi / 2.0) ** 2 for i in range(n_steps + 1)]
        betas = np.minimum(1.0 - np.array(level[1:]) / np.array(level[:-1]), _LARGEST_BETA)
        super().__init__(np.arange(n_steps), np.cumprod(1.0 - betas), betas)


class GeometricSchedule(Chain):
    """Noise over motion grows by the same factor in each step, for few steps (Karras et al. 2022 space alike).

    Args:
        n_steps: Diffusion steps T of the training.
    """

    def __init__(self, n_steps: int) -> None:
        super().__init__(np.arange(n_steps), 1.0 / (1.0 + np.geomspace(*_NOISE_RATIOS, n_steps) ** 2))


SCHEDULES: dict[str, Callable[[int], Chain]] = {"cosine": CosineSchedule, "geometric": GeometricSchedule}


class LinearSchedule(Chain):
    """β rises linearly from 0.0001 to 0.02, both times 1000 / T.

    Args:
        n_steps: Diffusion steps T of the training.
    """

    def __init__(self, n_steps: int) -> None:
        betas = np.linspace(1e-4, 0.02, n_steps) * 1000.0 / n_steps
        super().__init__(np.arange(n_steps), np.cumprod(1.0 - betas), betas)


def sample_ddpm(
    denoise: Denoise, schedule: Chain, start: State, noise: _DrawNoise, *, steps: int | None = None
) -> State:
    """Ancestral sampling: a draw from the posterior in each step, its mean in the last.

    Args:
        denoise: The (guided) denoiser.
        schedule: The training schedule.
        start: Standard normal noise, taken as the noisiest kept state.
        noise: Called once a step, the noisiest first, and not for the last.
        steps: How many to keep; all of them unless given.
    """
    chain = schedule.chain(len(schedule) if steps is None else steps)
    state = start
    for i in range(len(chain) - 1, -1, -1):
        index = int(chain.indices[i])
        clean = denoise(state, index)
        state = float(chain.posterior_mean_clean[i]) * clean + float(chain.posterior_mean_noisy[i]) * state
        if i:
            state = state + math.sqrt(chain.posterior_variance[i]) * noise(index)
    return state


def sample_ddim(
    denoise: Denoise,
    schedule: Chain,
    start: State,
    *,
    steps: int | None = None,
    spacing: Spacing = "leading",
    checkpointing: int = 0,
) -> State:
    """Deterministic sampling (η = 0): a fixed, differentiable map from noise to clean features.

    Args:
        denoise: The (guided) denoiser.
        schedule: The training schedule.
        start: Standard normal noise, taken as the noisiest kept state.
        steps: How many to keep; all of them unless given.
        spacing: Which ones (:meth:`Chain.kept_steps`).
        checkpointing: If positive, only the states between blocks of so many steps are kept for the backward pass, and
            each block is computed once more there. The gradients stay the same; memory falls, time grows by a third.

    Returns:
        The clean estimate of the last step.
    """
    chain = schedule.chain(len(schedule) if steps is None else steps, spacing)
    # Factors are computed in float64 before the walk, so that no step rounds or waits for the device.
    of_clean, of_state = ddim_factors(chain.alphas_cumprod, chain.alphas_cumprod_previous)
    moves = [(int(chain.indices[i]), float(of_clean[i]), float(of_state[i])) for i in reversed(range(len(chain)))]
    state = start
    if checkpointing < 1 or not torch.is_grad_enabled():
        return _walk(denoise, state, moves)
    for first in range(0, len(moves), checkpointing):
        state = checkpoint(_walk, denoise, state, moves[first : first + checkpointing], use_reentrant=False)
    return state


def ddim_factors(here: Float[np.ndarray, "*n"], cleaner: Float[np.ndarray, "*n"]) -> _Factors:
    """Factors of the clean estimate x0 and of the state x in the next state of a deterministic step.

    √ᾱ' x0 + √(1 - ᾱ') ε with ε = (x - √ᾱ x0) / √(1 - ᾱ), collected by x0 and x.

    Args:
        here: ᾱ of the state.
        cleaner: ᾱ' of the next one; 1 for clean features.
    """
    of_state = np.sqrt((1.0 - cleaner) / (1.0 - here))
    return np.sqrt(cleaner) - np.sqrt(here) * of_state, of_state


def _walk(denoise: Denoise, state: Tensor, moves: list[_Move]) -> Tensor:
    for index, of_clean, of_state in moves:
        clean = denoise(state, index)
        state = clean if of_state == 0.0 else of_clean * clean + of_state * state
    return state
