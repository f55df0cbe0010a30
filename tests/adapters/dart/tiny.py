"""DART networks of random weights that are quick to run, as a model and as a weights file."""

from __future__ import annotations

from pathlib import Path

import msgspec
import torch

from prbench.text import text_encoder
from prbench_adapters.dart.model import (
    KIND,
    REPRESENTATION,
    DartConfiguration,
    DartModel,
    FeatureScaling,
    Frames,
    LatentDenoiser,
    PrimitiveVAE,
)
from prbench_adapters.diffusion.model import TextVectors
from prbench_adapters.kinematics import DART
from prbench_adapters.training.weights import write_weights
from tests.fakes import STANDING

SIZES = {
    "latent": 16,
    "vae_width": 16,
    "vae_heads": 2,
    "vae_layers": 3,
    "vae_feed_forward": 24,
    "width": 16,
    "heads": 2,
    "layers": 2,
    "feed_forward": 24,
    "dropout": 0.0,
    "text_encoder": "hashed-ngrams",
    "text_dimension": 64,
    "diffusion_steps": 4,
}


def networks(*, seed: int = 0, **changes: object) -> tuple[PrimitiveVAE, LatentDenoiser]:
    """Random numbers in every parameter; the last layer of the decoder so that the latent moves the body."""
    configuration = DartConfiguration(**{**SIZES, **changes})
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        pair = PrimitiveVAE(configuration), LatentDenoiser(configuration)
        for network in pair:
            for name, parameter in network.named_parameters():
                mean = 1.0 if name.endswith("norm.weight") else 0.0
                torch.nn.init.normal_(parameter, mean, 0.25 if parameter.ndim > 1 else 0.1)
    return pair


def scaling() -> FeatureScaling:
    """Statistics of a person who stands and sways: means are those of the standing body."""
    standing = torch.as_tensor(STANDING, dtype=torch.float32)[None, None].expand(1, 2, 22, 3)
    frames, _ = Frames.of_joints(DART.from_y_up(standing)).canonical()
    return FeatureScaling(frames.pack()[0, 0], torch.full((276,), 0.05))


def model(*, seed: int = 0, **changes: object) -> DartModel:
    """The networks with statistics."""
    vae, denoiser = networks(seed=seed, **changes)
    texts = TextVectors(text_encoder("hashed-ngrams"))
    return DartModel(vae, denoiser, scaling=scaling(), latent_std=0.8, texts=texts)


def write(path: Path, *, latent_std: float = 0.8, seed: int = 0, **changes: object) -> Path:
    """The same as a weights file."""
    vae, denoiser = networks(seed=seed, **changes)
    tensors = {f"vae.{name}": tensor for name, tensor in vae.state_dict().items()}
    tensors |= {f"denoiser.{name}": tensor for name, tensor in denoiser.state_dict().items()}
    tensors |= {
        "statistics.mean": scaling().mean,
        "statistics.std": scaling().std,
        "latent.std": torch.tensor([latent_std]),
    }
    header = {
        "kind": KIND,
        "configuration": msgspec.json.encode(vae.configuration).decode(),
        "representation": REPRESENTATION,
    }
    write_weights(path, tensors, header, {})
    return path
