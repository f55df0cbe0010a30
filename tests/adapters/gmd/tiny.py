"""Networks of random weights, as a model, as a weights file, and as GMD released its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor

from prbench.contract import Condition, ConditionBatch
from prbench.text import text_encoder
from prbench_adapters.diffusion.model import TextVectors
from prbench_adapters.gmd.model import FeatureSpace, GMDConfiguration, GMDModel, GMDNetworks, emphasis_projection
from prbench_adapters.gmd.public_weights import PublicFiles, original_name
from prbench_adapters.training.weights import write_weights
from tests.fakes import STANDING


def configuration(**changes: object) -> GMDConfiguration:
    """Two levels of width 8, fifty diffusion steps, at most 60 frames; the built-in text encoder."""
    values = {
        "motion_widths": (8, 8),
        "trajectory_widths": (8, 8),
        "condition_width": 8,
        "text_encoder": "hashed-ngrams",
        "text_dimension": 64,
        "diffusion_steps": 50,
        "max_frames": 60,
        "padded_frames": 16,
    }
    return GMDConfiguration(**{**values, **changes})


def networks(*, seed: int = 0, **changes: object) -> GMDNetworks:
    """In evaluation mode; random numbers in every parameter, also in those that start at zero."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        made = GMDNetworks(configuration(**changes))
        for name, parameter in made.named_parameters():
            mean = 1.0 if name.endswith("norm.weight") else 0.0
            torch.nn.init.normal_(parameter, mean, 0.1)
    return made.eval().requires_grad_(False)


def space(emphasis: float = 10.0) -> FeatureSpace:
    """Statistics of people who walk some decimetres."""
    mean, std = torch.linspace(-0.1, 0.1, 263), torch.linspace(0.3, 0.5, 263)
    return FeatureSpace.of(mean, std, emphasis_projection(emphasis))


def model(*, seed: int = 0, **changes: object) -> GMDModel:
    """The networks with statistics and projection."""
    return GMDModel(networks(seed=seed, **changes), space=space(), texts=TextVectors(text_encoder("hashed-ngrams")))


def write(path: Path, *, seed: int = 0, metadata: dict[str, str] | None = None, **changes: object) -> Path:
    """The same as a weights file."""
    made, found = networks(seed=seed, **changes), space()
    tensors = {f"networks.{name}": tensor for name, tensor in made.state_dict().items()}
    tensors |= {"statistics.mean": found.mean, "statistics.std": found.std, "projection": found.projection}
    header = {
        "kind": "gmd",
        "configuration": msgspec.json.encode(made.configuration).decode(),
        "representation": f"humanml3d-263/{made.configuration.representation}",
    }
    write_weights(path, tensors, {**header, **(metadata or {})}, {})
    return path


def batch(n_frames: tuple[int, ...] = (24, 17, 30)) -> ConditionBatch:
    """People who stand at the origin; goal poses around them, turned about the vertical by up to a right angle."""
    generator = np.random.default_rng(5)
    n = len(n_frames)
    standing = np.broadcast_to(STANDING.astype(np.float32), (n, 22, 3)).copy()
    angle = generator.uniform(-np.pi / 2, np.pi / 2, size=n)
    turn = np.zeros((n, 3, 3))
    turn[:, 0, 0], turn[:, 0, 2], turn[:, 1, 1] = np.cos(angle), np.sin(angle), 1.0
    turn[:, 2, 0], turn[:, 2, 2] = -np.sin(angle), np.cos(angle)
    offset = generator.uniform(-1.0, 1.0, size=(n, 1, 3)) * (1.0, 0.1, 1.0)
    return ConditionBatch(
        condition=Condition.GOAL_POSE,
        n_frames=np.array(n_frames),
        fps=20.0,
        opaque_id=tuple(f"{row:064d}" for row in range(n)),
        noise_seed=tuple(1000 + row for row in range(n)),
        text=tuple(("The person moves across and picks an object.",) * n),
        initial_joints=standing,
        previous_joints=standing - np.float32(0.01),
        goal_joints=(standing @ turn.transpose(0, 2, 1) + offset).astype(np.float32),
    )


RELEASED_SIZES = {"diffusion_steps": 1000, "text_dimension": 512, "padded_frames": 224, "padding_step": 8}


def released_networks(seed: int) -> Any:
    """Networks with the text vectors and steps of the released ones."""
    return networks(seed=seed, **RELEASED_SIZES, motion_widths=(16, 8, 8), trajectory_widths=(8, 16))


def state(network: torch.nn.Module) -> dict[str, Tensor]:
    """The parameters as the original calls them, with the two tables that it stores beside them."""
    table = torch.zeros(5000, 1, 8)
    tables = {"sequence_pos_encoder.pe": table, "embed_timestep.sequence_pos_encoder.pe": table}
    return tables | {original_name(name): tensor for name, tensor in network.state_dict().items()}


def write_released(folder: Path) -> PublicFiles:
    """Both checkpoints with a moving average of seed 0 beside the last step of seed 1; statistics and projection."""
    averaged, last, released = released_networks(0), released_networks(1), space()
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
    for name in ("mean", "std", "projection"):
        np.save(getattr(files, name), getattr(released, name).numpy())
    return files
