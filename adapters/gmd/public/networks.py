"""Sizes and parameters of the original's networks, read from their checkpoints."""

from __future__ import annotations

import torch
from torch import Tensor

from prbench.errors import InputFileError
from prbench.representation.features import N_FEATURES
from prbench.text import clip
from prbench_adapters.gmd.configuration import GMDConfiguration
from prbench_adapters.gmd.features import N_ROOT
from prbench_adapters.gmd.public.checkpoint import Checkpoint
from prbench_adapters.gmd.public.names import original_name
from prbench_adapters.gmd.unet import TemporalUNet

_PADDED_FRAMES = 224
_PADDING_STEP = 8


def configuration_of(motion: Checkpoint, trajectory: Checkpoint, emphasis: float) -> GMDConfiguration:
    """What the released networks are: sizes from their arrays, the rest from docs/specification/gmd.md#networks.

    Raises:
        InputFileError: if the files hold no such networks.
    """
    size, text_dimension = motion.require("embed_text.weight", (None, None)).shape
    motion_widths, trajectory_widths = widths_of(motion), widths_of(trajectory)
    levels = max(len(motion_widths), len(trajectory_widths))
    try:
        return GMDConfiguration(
            motion_widths=motion_widths,
            trajectory_widths=trajectory_widths,
            condition_width=size,
            emphasis=emphasis,
            text_encoder=clip.NAME,
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
    while not widths or _of_level(len(widths)) in checkpoint.tensors:
        widths.append(len(checkpoint.require(_of_level(len(widths)), (None,))))
    return tuple(widths)


def _of_level(level: int) -> str:
    return f"unet.downs.{level}.1.blocks.0.block1.0.bias"


def networks_of(motion: Checkpoint, trajectory: Checkpoint, configuration: GMDConfiguration) -> dict[str, Tensor]:
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
        InputFileError: as :func:`networks_of`.
    """
    wanted = {original_name(name): (name, tuple(tensor.shape)) for name, tensor in unet.state_dict().items()}
    found = {name: checkpoint.require(original, shape) for original, (name, shape) in wanted.items()}
    unknown = sorted(set(checkpoint.tensors) - set(wanted))
    if unknown:
        raise checkpoint.misfit(unknown[0], "only parameters of the network", "one more")
    return found
