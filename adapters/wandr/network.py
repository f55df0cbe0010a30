"""The conditional variational autoencoder of changes, with the statistics that it standardises by."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import msgspec
import torch
from jaxtyping import Float
from torch import nn

from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.training.weights import Weights, read_weights, weights_header
from prbench_adapters.wandr.state import DELTA_SIZE, INTENTION_SIZE, SEEN_SIZE

CONDITION_SIZE = SEEN_SIZE + DELTA_SIZE + INTENTION_SIZE
_SMALLEST = 1e-5  # added to every standard deviation
KIND = "wandr"
REPRESENTATION = "wandr-135"


class WandrConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of encoder and decoder; the defaults are those of the original (docs/specification/wandr.md#network).

    Raises:
        ValueError: for sizes that are not possible.
    """

    layers: int = 14
    """Linear layers of the encoder, and of the decoder."""
    widest: int = 512
    """No hidden layer is wider; without effect on the original's sizes."""
    latent: int = 64
    dropout: float = 0.03
    fps: float = 30.0
    original_deviation: bool = False
    """Draw the latent with exp(v) as its deviation, as the public program does, though its KL divergence takes v for a
    log-variance; otherwise with exp(v / 2). Only training draws from the encoder."""
    most_speed: float = 0.0
    """Longest intention of the wrist that the network is shown, metres a second, in training and in generation; 0 is no
    limit, as in the original. A body that is late is then asked for speeds that no training motion has, and falls
    towards the goal (docs/methods/wandr.md)."""

    def __post_init__(self) -> None:
        for name in ("layers", "widest", "latent"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"'dropout' must be in [0, 1), found {self.dropout}")
        if not self.fps > 0:
            raise ValueError(f"'fps' must be positive, found {self.fps}")
        if self.most_speed < 0:
            raise ValueError(f"'most_speed' must be at least 0, found {self.most_speed}")

    @property
    def speed_limit(self) -> float:
        """The longest intention of the wrist, metres a second; infinite where there is no limit."""
        return self.most_speed or math.inf


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
    # As the original sizes its layers (docs/specification/wandr.md#network).
    line = [inputs + (outputs - inputs) * place / layers for place in range(1, layers)]
    return [min(widest, 1 << (math.ceil(width) - 1).bit_length()) for width in line]


def _stack(inputs: int, outputs: int, configuration: WandrConfiguration) -> nn.Sequential:
    """Dropout, LayerNorm, Linear and ReLU in each layer; no ReLU in the last."""
    widths = [inputs, *hidden_widths(inputs, outputs, configuration.layers, configuration.widest), outputs]
    modules: list[nn.Module] = []
    for before, after in pairwise(widths):
        modules += [nn.Dropout(configuration.dropout), nn.LayerNorm(before), nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*modules[:-1])


def contents(network: WandrNetwork) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Tensors and header entries of a network."""
    metadata = weights_header(KIND, network.configuration, REPRESENTATION)
    return {f"network.{name}": tensor for name, tensor in network.state_dict().items()}, metadata


def network_of(weights: Weights) -> WandrNetwork:
    """The network that a file holds.

    Raises:
        InputFileError: if the tensors do not fit the configuration in the header.
    """
    network = WandrNetwork(weights.configuration(WandrConfiguration))
    weights.load_into(network, "network")
    return network


def load_network(path: Path, device: str) -> WandrNetwork:
    """A frozen network in double precision, where the device has that.

    A motion is hundreds of steps, each on the last one's result; in double precision what rounding adds stays below a
    micrometre, whatever the batch.

    Raises:
        AdapterError: if there is no such device.
        InputFileError: if the file holds no weights of WANDR, or misshaped ones.
    """
    where = torch_device(device)
    network = network_of(read_weights(path, kind=KIND)).eval().requires_grad_(False)
    return network.to(where, torch.float32 if where.type == "mps" else torch.float64)
