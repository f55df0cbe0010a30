"""Import of the files that GMD was released with, as one weights file of prbench.

Sizes of the networks come from the shapes of the arrays; names of the parameters are translated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor

import prbench
from prbench.errors import InputFileError, UsageError
from prbench.files.storage import file_digest
from prbench.representation.features import N_FEATURES
from prbench.text.pretrained import CLIP
from prbench_adapters.gmd.features import N_ROOT
from prbench_adapters.gmd.model import KIND
from prbench_adapters.gmd.public_files import (
    RELEASED,
    Checkpoint,
    emphasis_of,
    is_released,
    read_checkpoint,
    read_space,
)
from prbench_adapters.gmd.unet import GMDConfiguration, TemporalUNet
from prbench_adapters.training.weights import representation_entry, weights_header, write_weights

_RENAMED = (
    (r"^time_embedding", "embed_timestep.time_embed"),
    (r"^text_embedding", "embed_text"),
    (r"^condition", "unet.time_mlp"),
    (r"^head\.0\.convolution", "unet.final_conv.0.block.0"),
    (r"^head\.0\.norm", "unet.final_conv.0.block.2"),
    (r"^head\.1", "unet.final_conv.1"),
    (r"^middle\.0", "unet.mid_block1"),
    (r"^middle\.1", "unet.mid_block2"),
    (r"^(down|up)\.(\d+)\.blocks\.(\d)", r"unet.\1s.\2.\3"),
    (r"^(down|up)\.(\d+)\.resample", r"unet.\1s.\2.3.conv"),
    (r"\.first\.convolution\.", ".blocks.0.block1.0."),
    (r"\.first\.norm\.", ".blocks.0.block1.2."),
    (r"\.second\.convolution\.", ".blocks.1.block.0."),
    (r"\.second\.norm\.", ".blocks.1.block.2."),
    (r"\.condition\.", ".time_mlp.1."),
    (r"\.skip\.", ".residual_conv."),
)
_PADDED_FRAMES = 224
_PADDING_STEP = 8
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
    """Files that a user has downloaded."""

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
    """Report of what was written."""

    configuration: GMDConfiguration
    copies: dict[str, str]
    """Name of the copy that was taken, by network."""
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
    motion = read_checkpoint(files.motion)
    trajectory = read_checkpoint(files.trajectory)
    configuration = _configuration_of(motion, trajectory, emphasis_of(space))
    networks = _networks_of(motion, trajectory, configuration)
    tensors = {f"networks.{name}": tensor for name, tensor in networks.items()}
    tensors |= {"statistics.mean": space.mean, "statistics.std": space.std, "projection": space.projection}
    metadata = weights_header(KIND, configuration, representation_entry(configuration.representation))
    copies = {"motion": motion.copy, "trajectory": trajectory.copy}
    # After everything was checked: a wrong file leaves no weights behind.
    write_weights(out, tensors, metadata, _card(files, configuration, copies, networks))
    others = tuple(path for role, path in files.by_role().items() if role in RELEASED and not is_released(role, path))
    parameters = sum(tensor.numel() for tensor in networks.values())
    return Imported(configuration, copies, parameters, others)


def _configuration_of(motion: Checkpoint, trajectory: Checkpoint, emphasis: float) -> GMDConfiguration:
    """Describe the released networks: sizes from their arrays, the rest from docs/specification/gmd.md#networks.

    Raises:
        InputFileError: if the files hold no such networks.
    """
    size, text_dimension = motion.require("embed_text.weight", (None, None)).shape
    motion_widths = widths_of(motion)
    trajectory_widths = widths_of(trajectory)
    levels = max(len(motion_widths), len(trajectory_widths))
    try:
        return GMDConfiguration(
            motion_widths=motion_widths,
            trajectory_widths=trajectory_widths,
            condition_width=size,
            emphasis=emphasis,
            text_encoder=CLIP,
            text_dimension=text_dimension,
            diffusion_steps=1000,
            representation="reference",  # the original's own heading
            padded_frames=_PADDED_FRAMES,
            padding_step=max(_PADDING_STEP, 2 ** (levels - 1)),
            uniform_skeleton=True,  # HumanML3D's people share one
        )
    except ValueError as error:
        expected = "networks of GMD"
        raise InputFileError(motion.path, "sizes", expected=expected, found=f"others: {error}") from error


def widths_of(checkpoint: Checkpoint) -> tuple[int, ...]:
    """Channels of each level, the finest first; at least one.

    Raises:
        InputFileError: if the first level is missing, as it is in other networks.
    """
    widths: list[int] = []
    # The first level is required, so that a file of something else fails with its name.
    while not widths or _of_level(len(widths)) in checkpoint.tensors:
        widths.append(len(checkpoint.require(_of_level(len(widths)), (None,))))
    return tuple(widths)


def _of_level(level: int) -> str:
    return f"unet.downs.{level}.1.blocks.0.block1.0.bias"


def _networks_of(motion: Checkpoint, trajectory: Checkpoint, configuration: GMDConfiguration) -> dict[str, Tensor]:
    """The parameters of both networks by our names, ``motion.…`` and ``trajectory.…``.

    Raises:
        InputFileError: naming what a checkpoint lacks, has in another shape, or has beyond them.
    """
    with torch.device("meta"):  # names and shapes alone
        unets = (
            TemporalUNet(N_FEATURES, configuration.motion_widths, configuration),
            TemporalUNet(N_ROOT, configuration.trajectory_widths, configuration),
        )
    found = {}
    for prefix, checkpoint, unet in zip(("motion", "trajectory"), (motion, trajectory), unets, strict=True):
        found |= {f"{prefix}.{name}": tensor for name, tensor in parameters_of(checkpoint, unet).items()}
    return found


def parameters_of(checkpoint: Checkpoint, unet: TemporalUNet) -> dict[str, Tensor]:
    """The parameters of one network by our names.

    Args:
        checkpoint: Of the original.
        unet: Of the sizes that it should have.

    Raises:
        InputFileError: as :func:`_networks_of`.
    """
    wanted = {original_name(name): (name, tuple(tensor.shape)) for name, tensor in unet.state_dict().items()}
    found = {name: checkpoint.require(original, shape) for original, (name, shape) in wanted.items()}
    # A tensor too many means another architecture, even where all of ours are there.
    unknown = sorted(set(checkpoint.tensors) - set(wanted))
    if unknown:
        raise checkpoint.misfit(unknown[0], "only parameters of the network", "one more")
    return found


def original_name(name: str) -> str:
    """The original's name of a parameter of :class:`prbench_adapters.gmd.unet.TemporalUNet`."""
    for pattern, replacement in _RENAMED:
        name = re.sub(pattern, replacement, name)
    return name


def _card(
    files: PublicFiles, configuration: GMDConfiguration, copies: Mapping[str, str], networks: Mapping[str, Tensor]
) -> dict[str, Any]:
    """Say where the weights come from; prbench trained nothing of this, so there are no curves and no scores."""
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
