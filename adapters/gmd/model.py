"""Trained networks of GMD with all that belongs to them: feature space and text encoder."""

from __future__ import annotations

from pathlib import Path

import torch
from jaxtyping import Float

from prbench.representation.features import N_FEATURES
from prbench.text import text_encoder
from prbench_adapters.diffusion.denoiser import pooled
from prbench_adapters.diffusion.model import TextVectors, torch_device
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.gmd.features import N_ROOT, FeatureSpace
from prbench_adapters.gmd.unet import GMDConfiguration, TemporalUNet
from prbench_adapters.training.weights import Weights, read_weights

KIND = "gmd"


class GMDNetworks(torch.nn.Module):
    """The motion network, which estimates clean projected features; the trajectory network, which estimates noise."""

    def __init__(self, configuration: GMDConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.motion = TemporalUNet(N_FEATURES, configuration.motion_widths, configuration)
        self.trajectory = TemporalUNet(N_ROOT, configuration.trajectory_widths, configuration)


class GMDModel:
    """Frozen: what sampling works with.

    Args:
        networks: With trained weights; they are put into evaluation mode, their parameters ask for no gradients.
        space: Statistics and projection that they have learnt with.
        texts: Vectors of captions.
    """

    def __init__(self, networks: GMDNetworks, *, space: FeatureSpace, texts: TextVectors) -> None:
        self.networks = networks.eval().requires_grad_(False)
        self.configuration = networks.configuration
        self.device = next(networks.parameters()).device
        self.space, self.texts = space.to(self.device), texts
        self.schedule = CosineSchedule(self.configuration.diffusion_steps)

    @classmethod
    def load(cls, path: Path, device: str = "cpu", *, text_path: str | None = None) -> GMDModel:
        """Read a weights file (``prbench_adapters.training.weights``).

        Args:
            path: ``<name>.safetensors``.
            device: ``cpu``, ``cuda``, ``cuda:1`` …
            text_path: Where the text encoder's own files are, if it has some.

        Raises:
            AdapterError: if there is no such device.
            InputFileError: if the file holds no weights of GMD for this representation, or misshaped ones.
            UsageError: if its text encoder is unknown or has no files.
        """
        where = torch_device(device)
        weights = read_weights(path, kind=KIND)
        configuration = weights.configuration(GMDConfiguration)
        weights.require_representation(configuration.representation)
        networks = GMDNetworks(configuration)
        weights.load_into(networks, "networks")
        texts = TextVectors(text_encoder(configuration.text_encoder, text_path))
        return cls(networks.to(where), space=stored_space(weights), texts=texts)

    def encode(self, captions: tuple[str, ...]) -> Float[torch.Tensor, "batch dimension"]:
        """One vector a caption."""
        return caption_vectors(self.texts, captions).to(self.device)


def caption_vectors(texts: TextVectors, captions: tuple[str, ...]) -> Float[torch.Tensor, "batch dimension"]:
    """The mean over the word pieces of each caption."""
    tokens, padding = texts(captions)
    return pooled(tokens, padding)[:, 0]


def stored_space(weights: Weights) -> FeatureSpace:
    """Statistics and projection of a weights file.

    Raises:
        InputFileError: if one is missing or misshaped.
    """
    return FeatureSpace.of(
        weights.require("statistics.mean", (N_FEATURES,)),
        weights.require("statistics.std", (N_FEATURES,)),
        weights.require("projection", (N_FEATURES, N_FEATURES)),
    )
