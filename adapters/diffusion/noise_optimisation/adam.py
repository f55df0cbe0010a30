"""Adam over rows that may leave the batch while the others go on."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int

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
        moved = noise - learning_rate / (1.0 - _BETAS[0] ** steps) * first / scale
        return moved, AdamState(first, second, steps)


def unit_gradient(gradient: Noise) -> tuple[Noise, Float[torch.Tensor, " batch"]]:
    """Each row's gradient at length 1 over frames and features, and the lengths that they had.

    A zero gradient stays zero: the divisor is at least 1e-12.
    """
    lengths = gradient.flatten(1).norm(dim=1)
    return gradient / lengths.clamp_min(_SHORTEST_GRADIENT)[:, None, None], lengths
