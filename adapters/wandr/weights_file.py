"""Weights of WANDR on disk: encoder, decoder and statistics in one file (``prbench.training.weights``)."""

from __future__ import annotations

from pathlib import Path

import msgspec
import torch

from prbench.errors import AdapterError
from prbench.training.weights import Weights, read_weights
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.wandr.configuration import WandrConfiguration
from prbench_adapters.wandr.network import WandrNetwork

KIND = "wandr"
REPRESENTATION = "wandr-135"

_FOLDER = Path(__file__).with_name("weights")
_SUFFIX = ".safetensors"


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
    bundled = {path.stem: path for path in sorted(_FOLDER.glob(f"*{_SUFFIX}"))}
    if weights is None and "wandr-small" not in bundled:
        raise AdapterError(
            "wandr: no weights come with this version of prbench. Train some"
            " (`prbench train --method wandr --config small --data …`) and give --weights."
        )
    chosen = Path("wandr-small") if weights is None else weights
    if chosen.is_file():
        return chosen
    if chosen.is_dir():
        found = sorted(chosen.glob(f"*{_SUFFIX}"))
        if len(found) == 1:
            return found[0]
        listed = ", ".join(path.name for path in found) or "none"
        raise AdapterError(f"weights {chosen}: expected one {_SUFFIX} file in the folder, found {listed}.")
    if str(chosen) in bundled:
        return bundled[str(chosen)]
    known = ", ".join(bundled) or "none in this installation"
    raise AdapterError(
        f"weights '{chosen}': expected a file, a folder, or bundled weights ({known}); found none of these."
    )
