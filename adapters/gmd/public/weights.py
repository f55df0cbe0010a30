"""From the files that GMD was released with to one weights file of prbench."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import msgspec
from torch import Tensor

import prbench
from prbench.errors import UsageError
from prbench.storage import file_digest
from prbench.training.weights import representation_entry, write_weights
from prbench_adapters.gmd.configuration import GMDConfiguration
from prbench_adapters.gmd.model import KIND
from prbench_adapters.gmd.public.arrays import RELEASED, emphasis_of, is_released, read_space
from prbench_adapters.gmd.public.checkpoint import read_checkpoint
from prbench_adapters.gmd.public.networks import configuration_of, networks_of

_SUFFIX = ".safetensors"
_CARD_VERSION = 1
_ORIGIN = (
    "GMD: Guided Motion Diffusion for Controllable Human Motion Synthesis (Karunratanakul et al., ICCV 2023),"
    " https://github.com/korrawe/guided-motion-diffusion"
)
_LICENCE = (
    "that of the imported files: the original's repository is under the MIT licence (copyright Korrawe Karunratanakul"
    " and Guy Tevet); CLIP and HumanML3D, on which the networks were trained, have their own terms"
)


@dataclass(frozen=True)
class PublicFiles:
    """What a user has downloaded."""

    motion: Path
    trajectory: Path
    mean: Path
    std: Path
    projection: Path

    def by_role(self) -> dict[str, Path]:
        """The files by the names of the fields."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class Imported:
    """What was written."""

    configuration: GMDConfiguration
    copies: dict[str, str]
    """Which copy of each network was taken."""
    parameters: int
    not_released: tuple[Path, ...]
    """Statistics and projection that are not those of the public repository."""


def import_public(files: PublicFiles, out: Path) -> Imported:
    """Write weights of ``prbench run --method gmd`` and their card.

    Args:
        files: Of the original.
        out: ``<name>.safetensors``; the card is written beside it. The same files give the same bytes.

    Raises:
        InputFileError: if a file is not what it should be; then nothing is written.
        StorageError: if the weights cannot be written.
        UsageError: if ``out`` has another suffix, or PyTorch is too old to open the files safely.
    """
    if out.suffix != _SUFFIX:
        raise UsageError(f"--out {out}: expected a name that ends with {_SUFFIX}.")
    space = read_space(files.mean, files.std, files.projection)
    motion, trajectory = read_checkpoint(files.motion), read_checkpoint(files.trajectory)
    configuration = configuration_of(motion, trajectory, emphasis_of(space))
    networks = networks_of(motion, trajectory, configuration)
    tensors = {f"networks.{name}": tensor for name, tensor in networks.items()}
    tensors |= {"statistics.mean": space.mean, "statistics.std": space.std, "projection": space.projection}
    metadata = {
        "kind": KIND,
        "configuration": msgspec.json.encode(configuration).decode(),
        "representation": representation_entry(configuration.representation),
    }
    copies = {"motion": motion.copy, "trajectory": trajectory.copy}
    write_weights(out, tensors, metadata, _card(files, configuration, copies, networks))
    others = tuple(path for role, path in files.by_role().items() if role in RELEASED and not is_released(role, path))
    parameters = sum(tensor.numel() for tensor in networks.values())
    return Imported(configuration, copies, parameters, others)


def _card(
    files: PublicFiles, configuration: GMDConfiguration, copies: Mapping[str, str], networks: Mapping[str, Tensor]
) -> dict[str, Any]:
    """Where the weights come from; nothing of this was trained by prbench, so there are no curves and no scores."""
    return {
        "card_version": _CARD_VERSION,
        "prbench": prbench.__version__,
        "method": "gmd",
        "stage": "imported",
        "origin": _ORIGIN,
        "licence": _LICENCE,
        "trained_on": "HumanML3D, by the authors of GMD",
        "parameters": sum(tensor.numel() for tensor in networks.values()),
        "configuration": {"model": msgspec.to_builtins(configuration)},
        "files": {
            role: {"name": path.name, "sha256": file_digest(path)}
            | ({"copy": copies[role]} if role in copies else {"as_released": is_released(role, path)})
            for role, path in files.by_role().items()
        },
    }
