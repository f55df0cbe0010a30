"""Files as GMD was released with, made of tiny random networks under the original's names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from prbench_adapters.gmd.public_weights import PublicFiles, original_name
from tests.adapters.gmd import tiny

SIZES = {"diffusion_steps": 1000, "text_dimension": 512, "padded_frames": 224, "padding_step": 8}


def networks(seed: int) -> Any:
    """Of the text vectors and steps that the released networks have."""
    return tiny.networks(seed=seed, **SIZES, motion_widths=(16, 8, 8), trajectory_widths=(8, 16))


def state(network: torch.nn.Module) -> dict[str, Tensor]:
    """The parameters as the original calls them, with the two tables that it stores beside them."""
    table = torch.zeros(5000, 1, 8)
    tables = {"sequence_pos_encoder.pe": table, "embed_timestep.sequence_pos_encoder.pe": table}
    return tables | {original_name(name): tensor for name, tensor in network.state_dict().items()}


def write(folder: Path) -> PublicFiles:
    """Both checkpoints with a moving average of seed 0 beside the last step of seed 1; statistics and projection."""
    averaged, last, space = networks(0), networks(1), tiny.space()
    files = PublicFiles(
        folder / "model000500000.pt",
        folder / "model000062500.pt",
        folder / "Mean_abs_3d.npy",
        folder / "Std_abs_3d.npy",
        folder / "rand_proj.npy",
    )
    for name, path in (("motion", files.motion), ("trajectory", files.trajectory)):
        copies = {"model": state(getattr(last, name)), "model_avg": state(getattr(averaged, name))}
        torch.save(copies, path)
    for array, path in ((space.mean, files.mean), (space.std, files.std), (space.projection, files.projection)):
        np.save(path, array.numpy())
    return files
