"""Trained networks of DART with all that belongs to them: statistics, scale of latents, text encoder."""

from __future__ import annotations

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from prbench.errors import InputFileError
from prbench.text import text_encoder
from prbench_adapters.dart.configuration import DartConfiguration
from prbench_adapters.dart.frames import N_FEATURES, Frames
from prbench_adapters.dart.networks import LatentDenoiser, PrimitiveVAE
from prbench_adapters.diffusion.denoiser import pooled
from prbench_adapters.diffusion.model import TextVectors, torch_device
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.training.weights import Weights, read_weights

KIND = "dart"
REPRESENTATION = f"dart-{N_FEATURES}/fitted"
"""Header entry: the 276 features, with rotations fitted to joints instead of those of a body model."""


class FeatureScaling:
    """Frames as standardised features and back.

    Args:
        mean: Of the features of training primitives, each in the frame of reference of its primitive.
        std: Likewise, floored.
    """

    def __init__(self, mean: Float[Tensor, " 276"], std: Float[Tensor, " 276"]) -> None:
        self.mean, self.std = mean, std

    def standardised(self, frames: Frames) -> Float[Tensor, "batch frames 276"]:
        """Standardise frames, as the networks see them."""
        return (frames.pack() - self.mean) / self.std

    def frames(self, standardised: Float[Tensor, "batch frames 276"]) -> Frames:
        """Restore frames from what the networks put out."""
        return Frames.unpack(standardised * self.std + self.mean)


class DartModel:
    """Frozen: what rolling out and noise optimisation work with.

    Args:
        vae: With trained weights; put into evaluation mode, its parameters ask for no gradients.
        denoiser: Likewise.
        scaling: Of the features.
        latent_std: Standard deviation of all numbers of the latents of training primitives.
        texts: Vectors of captions.
    """

    def __init__(
        self,
        vae: PrimitiveVAE,
        denoiser: LatentDenoiser,
        *,
        scaling: FeatureScaling,
        latent_std: float,
        texts: TextVectors,
    ) -> None:
        self.vae = vae.eval().requires_grad_(False)
        self.denoiser = denoiser.eval().requires_grad_(False)
        self.device = denoiser.head.weight.device
        self.scaling = FeatureScaling(scaling.mean.to(self.device), scaling.std.to(self.device))
        self.latent_std = latent_std
        self.texts = texts
        self.schedule = CosineSchedule(self.configuration.diffusion_steps)

    @property
    def configuration(self) -> DartConfiguration:
        """Sizes, text and diffusion."""
        return self.denoiser.configuration

    @classmethod
    def load(cls, path: Path, device: str = "cpu", *, text_path: str | None = None) -> DartModel:
        """Read a weights file (``prbench_adapters.training.weights``).

        Args:
            path: ``<name>.safetensors``.
            device: ``cpu``, ``cuda``, ``cuda:1`` …
            text_path: Where the text encoder's own files are, if it has some.

        Raises:
            AdapterError: if there is no such device.
            InputFileError: if the file holds no weights of DART, misshaped ones, or those of a training that was
                stopped before its second phase.
            UsageError: if its text encoder is unknown or has no files.
        """
        where = torch_device(device)
        weights = read_weights(path, kind=KIND)
        configuration = weights.configuration(DartConfiguration)
        vae = PrimitiveVAE(configuration)
        denoiser = LatentDenoiser(configuration)
        weights.load_into(vae, "vae")
        weights.load_into(denoiser, "denoiser")
        return cls(
            vae.to(where),
            denoiser.to(where),
            scaling=scaling_of(weights),
            latent_std=_trained_latent_std(weights),
            texts=TextVectors(text_encoder(configuration.text_encoder, text_path)),
        )

    def text_vectors(self, texts: tuple[str, ...]) -> Float[Tensor, "batch dimension"]:
        """One vector a text, on the model's device."""
        return pooled_texts(self.texts, texts).to(self.device)


def pooled_texts(vectors: TextVectors, texts: tuple[str, ...]) -> Float[Tensor, "batch dimension"]:
    """The mean of each text's token vectors; zeros for an empty text, which is how the networks are told of none."""
    # Text encoders give vectors for an empty text, too, and the networks know none by zeros.
    said = torch.tensor([bool(text.strip()) for text in texts])
    return pooled(*vectors(texts))[:, 0] * said[:, None]


def scaling_of(weights: Weights) -> FeatureScaling:
    """The statistics of a weights file.

    Raises:
        InputFileError: if there are none.
    """
    shape = (N_FEATURES,)
    return FeatureScaling(weights.require("statistics.mean", shape), weights.require("statistics.std", shape))


def _trained_latent_std(weights: Weights) -> float:
    latent_std = float(weights.require("latent.std", (1,)))
    if not latent_std > 0:
        raise InputFileError(
            weights.path,
            "latent.std",
            expected="a positive number",
            found=f"{latent_std:g}",
            remedy="The training was stopped while it trained the VAE; go on with the same `prbench train` command.",
        )
    return latent_std
