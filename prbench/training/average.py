"""The exponential moving average of the weights, which is what is validated and saved.

Source: docs/specification/mdm.md#training.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
from torch import nn


class WeightAverage:
    """Averages of the trained parameters, kept in float32 on their device.

    Args:
        module: Whose parameters; only those that require gradients.
        decay: At most; 0 follows the weights themselves.
        warmup: Average over fewer steps at first: the decay at step n is at most (1 + n) / (10 + n).
    """

    def __init__(self, module: nn.Module, decay: float, *, warmup: bool = True) -> None:
        self.decay, self.warmup = decay, warmup
        self.parameters = trained_parameters(module)
        self.averages = {name: parameter.detach().clone() for name, parameter in self.parameters.items()}

    @torch.no_grad()
    def update(self, steps_done: int) -> None:
        """Take in the weights as they are after ``steps_done`` steps (1 after the first)."""
        decay = min(self.decay, (1 + steps_done) / (10 + steps_done)) if self.warmup else self.decay
        averages = list(self.averages.values())
        parameters: list[torch.Tensor] = list(self.parameters.values())
        torch._foreach_lerp_(averages, parameters, 1 - decay)  # pyright: ignore[reportPrivateImportUsage]

    @contextlib.contextmanager
    def applied(self) -> Iterator[None]:
        """Put the averages in the module's place while the block runs, and the weights back afterwards, to the bit."""
        self._exchange()
        try:
            yield
        finally:
            self._exchange()

    @torch.no_grad()
    def _exchange(self) -> None:
        for name, parameter in self.parameters.items():
            held = parameter.detach().clone()
            parameter.copy_(self.averages[name])
            self.averages[name].copy_(held)


def trained_parameters(module: nn.Module) -> dict[str, nn.Parameter]:
    """The parameters that require gradients, by name."""
    return {name: parameter for name, parameter in module.named_parameters() if parameter.requires_grad}
