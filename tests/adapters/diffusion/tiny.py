"""A denoiser of random weights that is quick to run, as a model and as a weights file."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.text import text_encoder
from prbench_adapters.diffusion.configuration import ConditionScaling, DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser, FrameDenoiser
from prbench_adapters.diffusion.model import MotionModel, TextVectors, network
from prbench_adapters.training.weights import write_weights

TEXTS = ("The person moves across and picks an object.", "The person moves across and puts an object down there.")


def configuration(**changes: object) -> DenoiserConfiguration:
    """Width 16, two layers, eight diffusion steps, at most 40 frames; the built-in text encoder."""
    values = {
        "width": 16,
        "layers": 2,
        "heads": 2,
        "feed_forward": 24,
        "text_encoder": "hashed-ngrams",
        "text_dimension": 64,
        "diffusion_steps": 8,
        "max_frames": 40,
    }
    return DenoiserConfiguration(**{**values, **changes})


def denoiser(*, seed: int = 0, **changes: object) -> Denoiser | FrameDenoiser:
    """In evaluation mode; random numbers in every parameter, also in those that start at zero.

    Small enough that sampling does not blow up rounding, large enough that everything matters.
    """
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        found = network(configuration(**changes))
        for name, parameter in found.named_parameters():
            mean = 1.0 if name.endswith("norm.weight") else 0.0
            torch.nn.init.normal_(parameter, mean, 0.15 if parameter.ndim > 1 else 0.1)
    return found.eval().requires_grad_(False)


def statistics(columns: int = 263) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and standard deviation that give motions of some decimetres."""
    return torch.linspace(-0.01, 0.01, columns), torch.full((columns,), 0.02)


def model(*, seed: int = 0, **changes: object) -> MotionModel:
    """The denoiser with statistics."""
    found = denoiser(seed=seed, **changes)
    mean, std = statistics(found.configuration.n_features)
    size = found.configuration.condition_size
    scaling = ConditionScaling.of(found.configuration, torch.zeros(size), torch.ones(size)) if size else None
    return MotionModel(found, mean=mean, std=std, scaling=scaling, texts=TextVectors(text_encoder("hashed-ngrams")))


def write(path: Path, *, seed: int = 0, metadata: dict[str, str] | None = None, **changes: object) -> Path:
    """The same as a weights file."""
    found = denoiser(seed=seed, **changes)
    mean, std = statistics(found.configuration.n_features)
    tensors = {f"denoiser.{name}": tensor for name, tensor in found.state_dict().items()}
    tensors |= {"statistics.mean": mean, "statistics.std": std}
    size = found.configuration.condition_size
    if size:
        tensors |= {"condition.mean": torch.zeros(size), "condition.std": torch.ones(size)}
    header = {
        "kind": "denoiser",
        "configuration": msgspec.json.encode(found.configuration).decode(),
        "representation": f"humanml3d-263/{found.configuration.representation}",
    }
    write_weights(path, tensors, {**header, **(metadata or {})}, {})
    return path


def text_batch(n_frames: list[int], *, first_seed: int = 100) -> ConditionBatch:
    """Condition ``text``; seeds count up from ``first_seed``, the two texts alternate."""
    n = len(n_frames)
    return ConditionBatch(
        condition=Condition.TEXT,
        n_frames=np.array(n_frames),
        fps=20.0,
        opaque_id=tuple(str(i) for i in range(n)),
        noise_seed=tuple(first_seed + i for i in range(n)),
        text=tuple(TEXTS[i % 2] for i in range(n)),
    )


class LinearDecoder:
    """Joints = features 0 … 65 / 10; counts its calls as passes."""

    def __init__(self, counter: list[int] | None = None) -> None:
        self._counter = [0] if counter is None else counter

    @property
    def network_passes(self) -> int:
        return self._counter[0]

    def __call__(self, noise):
        self._counter[0] += 1
        return noise[..., :66].unflatten(-1, (22, 3)) / 10.0

    def rows(self, index):
        return LinearDecoder(self._counter)


def noise(batch: int, frames: int, features: int = 70, *, seed: int = 0) -> torch.Tensor:
    return torch.randn(batch, frames, features, generator=torch.Generator().manual_seed(seed))
