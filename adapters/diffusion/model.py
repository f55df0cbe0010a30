"""A trained denoiser with all that belongs to it: statistics, scaling of conditions, text encoder."""

from __future__ import annotations

from pathlib import Path

import torch
from jaxtyping import Float

from prbench.contract import ConditionBatch
from prbench.errors import AdapterError
from prbench.representation.features import N_FEATURES
from prbench.representation.tensors import decode
from prbench.text import text_encoder
from prbench.training.weights import Weights, read_weights
from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.condition_vector import ConditionScaling, raw_condition_of
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.schedule import CosineSchedule
from prbench_adapters.diffusion.text_vectors import TextVectors

KIND = "denoiser"


class MotionModel:
    """Frozen: what sampling and noise optimisation work with.

    Args:
        denoiser: With trained weights; it is put into evaluation mode, its parameters ask for no gradients.
        mean: Of the features that it has learnt.
        std: Likewise.
        scaling: Of the condition vector; None for a model without a goal.
        texts: Vectors of captions.
        digest: SHA-256 of the weights file, if there is one.
    """

    def __init__(
        self,
        denoiser: Denoiser,
        *,
        mean: Float[torch.Tensor, " 263"],
        std: Float[torch.Tensor, " 263"],
        scaling: ConditionScaling | None,
        texts: TextVectors,
        digest: str | None = None,
    ) -> None:
        self.denoiser = denoiser.eval().requires_grad_(False)
        self.device = denoiser.head.weight.device
        self.mean, self.std = mean.to(self.device), std.to(self.device)
        self.scaling, self.texts, self.digest = scaling, texts, digest
        self.schedule = CosineSchedule(self.configuration.diffusion_steps)

    @property
    def configuration(self) -> DenoiserConfiguration:
        """Architecture, conditions and data."""
        return self.denoiser.configuration

    @classmethod
    def load(cls, path: Path, device: str = "cpu", *, text_path: str | None = None) -> MotionModel:
        """Read a weights file (``prbench.training.weights``).

        Args:
            path: ``<name>.safetensors``.
            device: ``cpu``, ``cuda``, ``cuda:1`` …
            text_path: Where the text encoder's own files are, if it has some.

        Raises:
            AdapterError: if there is no such device.
            InputFileError: if the file holds no weights of a denoiser for this representation, or misshaped ones.
            UsageError: if its text encoder is unknown or has no files.
        """
        where = torch_device(device)
        weights = read_weights(path, kind=KIND)
        configuration = weights.configuration(DenoiserConfiguration)
        weights.require_representation(configuration.representation)
        denoiser = Denoiser(configuration)
        weights.load_into(denoiser, "denoiser")
        return cls(
            denoiser.to(where),
            mean=weights.require("statistics.mean", (N_FEATURES,)),
            std=weights.require("statistics.std", (N_FEATURES,)),
            scaling=_scaling(weights, configuration),
            texts=TextVectors(text_encoder(configuration.text_encoder, text_path)),
            digest=weights.digest,
        )

    def encode(self, batch: ConditionBatch, *, texts: tuple[str, ...] | None = None) -> EncodedCondition:
        """What the network is told about a batch.

        Args:
            batch: On the skeleton of the model (:mod:`prbench_adapters.diffusion.skeletons`).
            texts: Instead of the batch's own.

        Raises:
            ValueError: if the batch lacks a condition that the model needs.
        """
        wanted = batch.text if texts is None else texts
        if wanted is None:
            raise ValueError(f"a text-conditioned model cannot use the condition '{batch.condition.value}'")
        text, padding = self.texts(wanted)
        raw = raw_condition_of(batch, self.configuration)
        vector = None if raw is None or self.scaling is None else self.scaling(raw)
        return EncodedCondition(text, padding, vector).to(self.device)

    def joints(self, normalised: Float[torch.Tensor, "batch frames 263"]) -> Float[torch.Tensor, "batch frames 22 3"]:
        """Joints of standardised features, canonical frame, metres; differentiable, in float32 at least."""
        features = normalised if normalised.dtype == torch.float64 else normalised.float()
        return decode(features * self.std.to(features.dtype) + self.mean.to(features.dtype))


def require_goal(model: MotionModel, path: Path, goal: str) -> None:
    """Refuse weights that were trained for another kind of goal.

    Raises:
        AdapterError: naming both.
    """
    if model.configuration.goal != goal:
        raise AdapterError(
            f"weights {path}: expected a model of goal '{goal}', found one of goal '{model.configuration.goal}'."
            " Choose weights that were trained for this method and condition."
        )


def torch_device(name: str) -> torch.device:
    """The device of this name.

    Raises:
        AdapterError: if there is none.
    """
    try:
        device = torch.device(name)
        if device.type == "cuda" and not torch.cuda.is_available():
            raise AdapterError(f"--device {name}: there is no usable GPU here. Use --device cpu.")
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise AdapterError(f"--device {name}: cannot be used: {reason}. Use cpu, cuda, cuda:1 …") from error
    return device


def _scaling(weights: Weights, configuration: DenoiserConfiguration) -> ConditionScaling | None:
    if configuration.goal == "none":
        return None
    size = (configuration.condition_size,)
    mean, std = weights.require("condition.mean", size), weights.require("condition.std", size)
    return ConditionScaling.of(configuration, mean, std)
