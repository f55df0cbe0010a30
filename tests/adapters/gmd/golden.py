"""The tiny networks of the sample folder as ours: the importer maps the original's parameter names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from prbench_adapters.gmd.model import GMDConfiguration, TemporalUNet
from prbench_adapters.gmd.public_weights import Checkpoint, parameters_of, widths_of
from tests.adapters.diffusion.golden import features, load

__all__ = ["checkpoint", "features", "load", "network"]

STEPS = 1000
WINDOW = 224


def checkpoint(arrays: dict[str, np.ndarray]) -> Checkpoint:
    """The parameters of one file as the original's checkpoint of them."""
    weights = {key[2:]: torch.from_numpy(value.astype(np.float32)) for key, value in arrays.items() if key[:2] == "w/"}
    return Checkpoint(Path("golden.npz"), "only", weights)


def network(arrays: dict[str, np.ndarray]) -> TemporalUNet:
    """The network of one file; its sizes are read from its arrays."""
    found = checkpoint(arrays)
    size, text_dimension = found.tensors["embed_text.weight"].shape
    configuration = GMDConfiguration(condition_width=size, text_dimension=text_dimension, diffusion_steps=STEPS)
    unet = TemporalUNet(arrays["x_t"].shape[1], widths_of(found), configuration)
    unet.load_state_dict(parameters_of(found, unet))
    return unet.eval().requires_grad_(False)
