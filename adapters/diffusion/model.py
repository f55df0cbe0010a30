"""A trained denoiser with all that belongs to it: statistics, scaling of conditions, text encoder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float

from prbench.contract import ConditionBatch
from prbench.errors import AdapterError, UsageError
from prbench.representation.tensors import decode
from prbench.text import TextEncoder, padded, text_encoder
from prbench_adapters.diffusion.configuration import ConditionScaling, DenoiserConfiguration, EncodedCondition
from prbench_adapters.diffusion.denoiser import Counts, Denoiser, FrameDenoiser, Network
from prbench_adapters.diffusion.goal_frame import TRAINED_WITH, GoalFrame, smoothed
from prbench_adapters.diffusion.sampling import SCHEDULES
from prbench_adapters.training.weights import Weights, read_weights

Tokens = Float[torch.Tensor, "texts tokens dimension"]

# Kept at once; of Nymeria's narrations in DistilBERT's vectors these are about 3 GB.
_MOST_TEXTS = 65_536
KIND = "denoiser"
# Averages over neighbouring frames that take the tremble out of generated features, one of which training knows. After
# three, accelerations of wrists and trunk exceed people's in a tenth of MDM's motions instead of a fifth.
SMOOTHINGS = 3


class TextVectors:
    """A frozen text encoder that remembers what it has encoded."""

    def __init__(self, encoder: TextEncoder) -> None:
        self.encoder = encoder
        self._known: dict[str, Float[np.ndarray, "tokens dimension"]] = {}

    @classmethod
    def of_model(cls, name: str, dimension: int) -> TextVectors:
        """Vectors of the encoder that the table ``[model]`` names.

        Args:
            name: Its ``text_encoder``.
            dimension: Its ``text_dimension``.

        Raises:
            UsageError: if there is no such encoder, or its vectors have another size.
        """
        encoder = text_encoder(name)
        if encoder.dimension != dimension:
            problem = f"the text encoder '{name}' has vectors of {encoder.dimension} numbers, found {dimension}."
            raise UsageError(f"model.text_dimension: {problem}")
        return cls(encoder)

    @property
    def origin(self) -> str:
        """A line for the card of weights that build upon it."""
        return f"text encoder {self.encoder.name} (frozen)"

    def __call__(self, texts: Sequence[str]) -> tuple[Tokens, Bool[torch.Tensor, "texts tokens"]]:
        """Token vectors, zero where there is padding, and the padding itself (True = no token), on the CPU."""
        # Sorted, so that the encoder sees the same batch whatever the order of the rows.
        missing = sorted({text for text in texts if text not in self._known})
        if missing:
            if len(self._known) + len(missing) > _MOST_TEXTS:  # forget all but what this batch needs
                self._known = {text: self._known[text] for text in texts if text in self._known}
            encoded = self.encoder.encode(missing)
            for text, tokens, padding in zip(missing, encoded.tokens, encoded.padding, strict=True):
                self._known[text] = tokens[~padding].copy()
        stacked = padded([self._known[text] for text in texts], self.encoder.dimension)
        return torch.from_numpy(stacked.tokens), torch.from_numpy(stacked.padding)


class MotionModel:
    """Frozen: what sampling and noise optimisation work with.

    Args:
        denoiser: The trained denoiser; it is put into evaluation mode, its parameters ask for no gradients.
        mean: Mean of the features that it has learnt.
        std: Their standard deviation.
        scaling: Scaling of the condition vector; None for a model without a goal.
        texts: Vectors of captions.
        digest: SHA-256 of the weights file, if there is one.
    """

    def __init__(
        self,
        denoiser: Network,
        *,
        mean: Float[torch.Tensor, " features"],
        std: Float[torch.Tensor, " features"],
        scaling: ConditionScaling | None,
        texts: TextVectors,
        digest: str | None = None,
    ) -> None:
        self.denoiser = denoiser.eval().requires_grad_(False)
        self.device = denoiser.head.weight.device
        self.mean, self.std = mean.to(self.device), std.to(self.device)
        self.scaling, self.texts, self.digest = scaling, texts, digest
        self.schedule = SCHEDULES[self.configuration.noise_schedule](self.configuration.diffusion_steps)

    @property
    def configuration(self) -> DenoiserConfiguration:
        """Architecture, conditions and data."""
        return self.denoiser.configuration

    @classmethod
    def load(cls, path: Path, device: str = "cpu", *, text_path: str | None = None) -> MotionModel:
        """Read a weights file (``prbench_adapters.training.weights``).

        Args:
            path: ``<name>.safetensors``.
            device: ``cpu``, ``cuda``, ``cuda:1`` …
            text_path: Folder of the text encoder's own files, if it has some.

        Raises:
            AdapterError: if there is no such device.
            InputFileError: if the file holds no weights of a denoiser for this representation, or misshaped ones.
            UsageError: if its text encoder is unknown or has no files.
        """
        where = torch_device(device)
        weights = read_weights(path, kind=KIND)
        configuration = weights.configuration(DenoiserConfiguration)
        if configuration.features == "humanml3d":
            weights.require_representation(configuration.representation)
        mean, std = stored_statistics(weights, configuration)
        denoiser = network(configuration)
        weights.load_into(denoiser, "denoiser")
        scaling = stored_scaling(weights, configuration)
        texts = TextVectors(text_encoder(configuration.text_encoder, text_path))
        return cls(denoiser.to(where), mean=mean, std=std, scaling=scaling, texts=texts, digest=weights.digest)

    def encode(self, batch: ConditionBatch, *, texts: tuple[str, ...] | None = None) -> EncodedCondition:
        """Encode what the network is told about a batch.

        Args:
            batch: Conditions on the skeleton of the model (:mod:`prbench_adapters.diffusion.generation`).
            texts: Instead of the batch's own.

        Raises:
            ValueError: if the batch lacks a condition that the model needs.
        """
        wanted = batch.text if texts is None else texts
        if wanted is None:
            raise ValueError(f"a text-conditioned model cannot use the condition '{batch.condition.value}'")
        text, padding = self.texts(wanted)
        raw = self.configuration.raw_condition(batch)
        vector = None if raw is None or self.scaling is None else self.scaling(raw)
        return EncodedCondition(text, padding, vector, raw).to(self.device)

    def joints(
        self,
        normalised: Float[torch.Tensor, "batch frames features"],
        condition: EncodedCondition,
        n_frames: Counts,
        *,
        parts: frozenset[str] = TRAINED_WITH,
    ) -> Float[torch.Tensor, "batch frames 22 3"]:
        """Joints of standardised features, canonical frame, metres; differentiable, in float32 at least.

        Args:
            normalised: Features that the network has made.
            condition: What it was told: goal-frame features are measured from it.
            n_frames: Valid frames of each row.
            parts: What decoding of goal-frame features constructs (:data:`.goal_frame.PARTS`).
        """
        # Decoding sums up over frames, for which half precision is too coarse.
        features = normalised if normalised.dtype == torch.float64 else normalised.float()
        features = features * self.std + self.mean
        if self.configuration.features == "humanml3d":
            for _ in range(SMOOTHINGS if self.configuration.smoothed else 0):
                features = smoothed(features, n_frames)
            return decode(features)
        return goal_frame(condition, features).decode(features, n_frames, self.configuration.fps, parts=parts)


def network(configuration: DenoiserConfiguration) -> Network:
    """Make the network of a configuration, untrained."""
    return FrameDenoiser(configuration) if configuration.architecture == "frames" else Denoiser(configuration)


def goal_frame(condition: EncodedCondition, like: torch.Tensor) -> GoalFrame:
    """Return the frame that goal-frame features of these motions are measured in, in the precision of ``like``."""
    assert condition.given is not None
    return GoalFrame.of(condition.given.to(like.dtype))


def require_goal(model: MotionModel, path: Path, goal: str) -> None:
    """Refuse weights that were trained for another kind of goal.

    Raises:
        AdapterError: naming both.
    """
    if model.configuration.goal != goal:
        found = f"found one of goal '{model.configuration.goal}'."
        remedy = "Choose weights that were trained for this method and condition."
        raise AdapterError(f"weights {path}: expected a model of goal '{goal}', {found} {remedy}")


def torch_device(name: str) -> torch.device:
    """Return the device of this name.

    Raises:
        AdapterError: if there is none.
    """
    try:
        device = torch.device(name)
        if device.type == "cuda" and not torch.cuda.is_available():
            raise AdapterError(f"--device {name}: there is no usable GPU here. Use --device cpu.")
        # Naming a device does not touch it; only this fails where it is missing.
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise AdapterError(f"--device {name}: cannot be used: {reason}. Use cpu, cuda, cuda:1 …") from error
    return device


def stored_statistics(weights: Weights, configuration: DenoiserConfiguration) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and standard deviation of the features in a weights file.

    Raises:
        InputFileError: if they are missing or misshaped.
    """
    shape = (configuration.n_features,)
    return weights.require("statistics.mean", shape), weights.require("statistics.std", shape)


def stored_scaling(weights: Weights, configuration: DenoiserConfiguration) -> ConditionScaling | None:
    """Return the scaling of the condition vector in a weights file; None for a model without a goal.

    Raises:
        InputFileError: if it is missing or misshaped.
    """
    if configuration.goal == "none":
        return None
    size = (configuration.condition_size,)
    mean = weights.require("condition.mean", size)
    return ConditionScaling.of(configuration, mean, weights.require("condition.std", size))
