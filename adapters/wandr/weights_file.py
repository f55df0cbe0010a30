"""Weights of WANDR on disk: encoder, decoder and statistics in one file (``prbench.training.weights``)."""

from __future__ import annotations

from pathlib import Path

import msgspec
import torch

from prbench.training.weights import Weights, read_weights
from prbench_adapters.diffusion import bundled
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.wandr.configuration import WandrConfiguration
from prbench_adapters.wandr.network import WandrNetwork

KIND = "wandr"
REPRESENTATION = "wandr-135"

DEFAULT_WEIGHTS = "wandr-small"

_FOLDER = Path(__file__).with_name("weights")


def contents(network: WandrNetwork) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Tensors and header entries of a network."""
    metadata = {
        "kind": KIND,
        "configuration": msgspec.json.encode(network.configuration).decode(),
        "representation": REPRESENTATION,
    }
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


def resolve(weights: Path | None) -> Path:
    """The weights file that is meant: a file, a folder with one in it, a bundled name, or None for the bundled default.

    Raises:
        AdapterError: if there is nothing of that kind.
    """
    if weights is None:
        bundled.require_default("wandr", DEFAULT_WEIGHTS, _FOLDER)
    return bundled.resolve(weights, DEFAULT_WEIGHTS, folder=_FOLDER)
