"""The conditional variational autoencoder of changes, with the statistics that it standardises by."""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import nn

from prbench_adapters.wandr.configuration import WandrConfiguration
from prbench_adapters.wandr.intentions import INTENTION_SIZE
from prbench_adapters.wandr.state import DELTA_SIZE, SEEN_SIZE

CONDITION_SIZE = SEEN_SIZE + DELTA_SIZE + INTENTION_SIZE

_SMALLEST = 1e-5  # added to every standard deviation


class Standardisation(nn.Module):
    """Mean and standard deviation of each number; kept with the weights, never trained."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.mean: torch.Tensor
        self.std: torch.Tensor
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def forward(self, values: Float[torch.Tensor, "*batch size"]) -> Float[torch.Tensor, "*batch size"]:
        """Standardised values."""
        return (values - self.mean) / (self.std + _SMALLEST)

    def undone(self, values: Float[torch.Tensor, "*batch size"]) -> Float[torch.Tensor, "*batch size"]:
        """The values that were standardised."""
        return values * (self.std + _SMALLEST) + self.mean


class WandrNetwork(nn.Module):
    """Encoder (next change, condition) to a latent distribution; decoder (latent, condition) to the next change."""

    def __init__(self, configuration: WandrConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.encoder = _stack(DELTA_SIZE + CONDITION_SIZE, 2 * configuration.latent, configuration)
        self.decoder = _stack(configuration.latent + CONDITION_SIZE, DELTA_SIZE, configuration)
        self.seen, self.delta = Standardisation(SEEN_SIZE), Standardisation(DELTA_SIZE)

    def condition(
        self,
        seen: Float[torch.Tensor, "*batch 133"],
        delta: Float[torch.Tensor, "*batch 135"],
        intention: Float[torch.Tensor, "*batch 9"],
    ) -> Float[torch.Tensor, "*batch 277"]:
        """The condition of a step, from a state without yaw, the change that led to it, and intentions; all raw."""
        return torch.cat((self.seen(seen), self.delta(delta), intention), -1)

    def encode(
        self, delta: Float[torch.Tensor, "*batch 135"], condition: Float[torch.Tensor, "*batch 277"]
    ) -> tuple[Float[torch.Tensor, "*batch latent"], Float[torch.Tensor, "*batch latent"]]:
        """Mean and log-variance of the latent of a standardised change."""
        mean, log_variance = self.encoder(torch.cat((delta, condition), -1)).chunk(2, -1)
        return mean, log_variance

    def draw(
        self,
        mean: Float[torch.Tensor, "*batch latent"],
        log_variance: Float[torch.Tensor, "*batch latent"],
        noise: Float[torch.Tensor, "*batch latent"],
    ) -> Float[torch.Tensor, "*batch latent"]:
        """A latent of the distribution, from standard normal noise."""
        return mean + noise * (log_variance * (1.0 if self.configuration.original_deviation else 0.5)).exp()

    def decode(
        self, latent: Float[torch.Tensor, "*batch latent"], condition: Float[torch.Tensor, "*batch 277"]
    ) -> Float[torch.Tensor, "*batch 135"]:
        """The next change, standardised."""
        return self.decoder(torch.cat((latent, condition), -1))


def hidden_widths(inputs: int, outputs: int, layers: int, widest: int) -> list[int]:
    """Widths between input and output: on the straight line between both, rounded up to powers of two."""
    line = [inputs + (outputs - inputs) * place / layers for place in range(1, layers)]
    return [min(widest, 1 << (math.ceil(width) - 1).bit_length()) for width in line]


def _stack(inputs: int, outputs: int, configuration: WandrConfiguration) -> nn.Sequential:
    """Dropout, LayerNorm, Linear and ReLU in each layer; no ReLU in the last."""
    widths = [inputs, *hidden_widths(inputs, outputs, configuration.layers, configuration.widest), outputs]
    modules: list[nn.Module] = []
    for before, after in pairwise(widths):
        modules += [nn.Dropout(configuration.dropout), nn.LayerNorm(before), nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*modules[:-1])
