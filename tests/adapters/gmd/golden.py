"""The tiny networks of the sample folder as ours: the reference's parameter names mapped."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from prbench_adapters.gmd.configuration import GMDConfiguration
from prbench_adapters.gmd.unet import TemporalUNet

STEPS = 1000
WINDOW = 224

_RENAMED = [
    (r"^embed_timestep\.time_embed", "time_embedding"),
    (r"^embed_text", "text_embedding"),
    (r"^unet\.time_mlp", "condition"),
    (r"^unet\.final_conv\.0\.block\.0", "head.0.convolution"),
    (r"^unet\.final_conv\.0\.block\.2", "head.0.norm"),
    (r"^unet\.final_conv\.1", "head.1"),
    (r"^unet\.mid_block1", "middle.0"),
    (r"^unet\.mid_block2", "middle.1"),
    (r"^unet\.downs\.(\d)\.([01])", r"down.\1.blocks.\2"),
    (r"^unet\.downs\.(\d)\.3\.conv", r"down.\1.resample"),
    (r"^unet\.ups\.(\d)\.([01])", r"up.\1.blocks.\2"),
    (r"^unet\.ups\.(\d)\.3\.conv", r"up.\1.resample"),
    (r"blocks\.0\.block1\.0", "first.convolution"),
    (r"blocks\.0\.block1\.2", "first.norm"),
    (r"blocks\.1\.block\.0", "second.convolution"),
    (r"blocks\.1\.block\.2", "second.norm"),
    (r"time_mlp\.1", "condition"),
    (r"residual_conv", "skip"),
]


def load(samples: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of one file."""
    with np.load(samples / "metrics" / "networks" / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def network(arrays: dict[str, np.ndarray]) -> TemporalUNet:
    """The network of one file; its sizes are read from its arrays."""
    weights = {key[2:]: torch.from_numpy(value.astype(np.float32)) for key, value in arrays.items() if key[:2] == "w/"}
    widths = []
    while (name := f"unet.downs.{len(widths)}.1.blocks.0.block1.0.weight") in weights:
        widths.append(len(weights[name]))
    size, text_dimension = weights["embed_text.weight"].shape
    configuration = GMDConfiguration(condition_width=size, text_dimension=text_dimension, diffusion_steps=STEPS)
    unet = TemporalUNet(arrays["x_t"].shape[1], widths, configuration)
    unet.load_state_dict({_ours(name): value for name, value in weights.items()})
    return unet.eval().requires_grad_(False)


def _ours(name: str) -> str:
    for pattern, replacement in _RENAMED:
        name = re.sub(pattern, replacement, name)
    return name


def features(array: np.ndarray) -> Tensor:
    """(batch, channel, frame) as (batch, frame, channel)."""
    return torch.from_numpy(array.astype(np.float32)).transpose(1, 2).contiguous()
