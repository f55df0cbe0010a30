"""The tiny networks of the sample folder as ours, under the original's parameter names."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from prbench_adapters.gmd.model import GMDConfiguration, TemporalUNet

STEPS = 1000
WINDOW = 224
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


def load(samples: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of one file."""
    with np.load(samples / "metrics" / "networks" / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def network(arrays: dict[str, np.ndarray]) -> TemporalUNet:
    """The network of one file; its sizes are read from its arrays."""
    found = {key[2:]: torch.from_numpy(value.astype(np.float32)) for key, value in arrays.items() if key[:2] == "w/"}
    size, text_dimension = found["embed_text.weight"].shape
    configuration = GMDConfiguration(condition_width=size, text_dimension=text_dimension, diffusion_steps=STEPS)
    widths = []
    while (name := f"unet.downs.{len(widths)}.1.blocks.0.block1.0.bias") in found:
        widths.append(len(found[name]))
    unet = TemporalUNet(arrays["x_t"].shape[1], widths, configuration)
    unet.load_state_dict({name: found[original_name(name)] for name in unet.state_dict()})
    return unet.eval().requires_grad_(False)


def original_name(name: str) -> str:
    """The original's name of a parameter of ours."""
    for pattern, replacement in _RENAMED:
        name = re.sub(pattern, replacement, name)
    return name


def features(array: np.ndarray) -> Tensor:
    """(batch, channel, frame) as (batch, frame, channel)."""
    return torch.from_numpy(array.astype(np.float32)).transpose(1, 2).contiguous()
