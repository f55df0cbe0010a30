"""From noise to clean features: DDPM and DDIM over any number of steps (docs/specification/mdm.md#diffusion).

Both are differentiable from end to end. The coefficients are float64 numbers of the host, applied in the dtype of the
state, so that no step waits for the device.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from prbench_adapters.diffusion.schedule import CosineSchedule, Spacing

Denoise = Callable[[Tensor, int], Tensor]
"""Noisy features (batch, frames, features) and their index in the training schedule, to clean features."""

DrawNoise = Callable[[int], Tensor]
"""Index in the training schedule, to the standard normal noise (batch, frames, features) added in that step."""


def sample_ddpm(
    denoise: Denoise,
    schedule: CosineSchedule,
    start: Float[Tensor, "batch frames features"],
    noise: DrawNoise,
    *,
    steps: int | None = None,
) -> Float[Tensor, "batch frames features"]:
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
    schedule: CosineSchedule,
    start: Float[Tensor, "batch frames features"],
    *,
    steps: int | None = None,
    spacing: Spacing = "leading",
    checkpointing: int = 0,
) -> Float[Tensor, "batch frames features"]:
    """Deterministic sampling (η = 0): a fixed, differentiable map from noise to clean features.

    Args:
        denoise: The (guided) denoiser.
        schedule: The training schedule.
        start: Standard normal noise, taken as the noisiest kept state.
        steps: How many to keep; all of them unless given.
        spacing: Which ones (:meth:`CosineSchedule.kept_steps`).
        checkpointing: If positive, only the states between blocks of so many steps are kept for the backward pass, and
            each block is computed once more there. The gradients stay the same; memory falls, time grows by a third.

    Returns:
        The clean estimate of the last step.
    """
    moves = list(_ddim_moves(schedule, len(schedule) if steps is None else steps, spacing))
    state = start
    if checkpointing < 1 or not torch.is_grad_enabled():
        return _walk(denoise, state, moves)
    for first in range(0, len(moves), checkpointing):
        block = moves[first : first + checkpointing]
        state = checkpoint(_walk, denoise, state, block, use_reentrant=False)
    return state


_Move = tuple[int, float, float]
"""Index in the training schedule; factors of the clean estimate and of the state in the next state."""


def _ddim_moves(schedule: CosineSchedule, steps: int, spacing: Spacing) -> Iterator[_Move]:
    """√ᾱ' x0 + √(1 - ᾱ') ε with ε = (x - √ᾱ x0) / √(1 - ᾱ), collected by x0 and x; noisiest first."""
    chain = schedule.chain(steps, spacing)
    for i in range(len(chain) - 1, -1, -1):
        here, cleaner = chain.alphas_cumprod[i], chain.alphas_cumprod_previous[i]
        of_state = math.sqrt((1.0 - cleaner) / (1.0 - here))
        yield int(chain.indices[i]), math.sqrt(cleaner) - math.sqrt(here) * of_state, of_state


def _walk(denoise: Denoise, state: Tensor, moves: list[_Move]) -> Tensor:
    for index, of_clean, of_state in moves:
        clean = denoise(state, index)
        state = clean if of_state == 0.0 else of_clean * clean + of_state * state
    return state
