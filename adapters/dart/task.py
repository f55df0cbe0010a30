"""The training task ``dart``: from a ``[model]`` table, data and initial weights to a module to train."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from prbench.errors import InputFileError, UsageError
from prbench.text import text_encoder
from prbench.training.task import TrainingData
from prbench.training.weights import Weights, read_weights
from prbench_adapters.dart.configuration import DartConfiguration
from prbench_adapters.dart.losses import Objective
from prbench_adapters.dart.model import KIND, scaling_of
from prbench_adapters.dart.networks import LatentDenoiser, PrimitiveVAE
from prbench_adapters.dart.training import DartTraining
from prbench_adapters.dart.windows import feature_scaling
from prbench_adapters.diffusion.text_vectors import TextVectors

FREE_TO_CHANGE = frozenset({"dropout", "uniform_skeleton"})
"""What fine-tuning may set otherwise than the weights that it starts from."""


class DartTask:
    """A training task (:class:`prbench.training.task.TrainingTask`)."""

    name = "dart"
    configurations = "prbench_adapters.dart"

    def build(
        self,
        model: Mapping[str, Any],
        *,
        data: TrainingData,
        initial: Path | None,
        stage: str,  # noqa: ARG002 - both are trained alike
    ) -> DartTraining:
        """Make both networks in their state before the first step.

        Statistics come from the initial weights where there are some, else from the training split.

        Args:
            model: Keys of :class:`DartConfiguration` and of :class:`Objective`.
            data: The training split.
            initial: Weights to start from.
            stage: ``pretrain`` or ``finetune``.

        Raises:
            UsageError: if the table does not describe such a model, or the data do not fit it.
            InputFileError: if the initial weights do not fit it.
        """
        configuration, objective = read_model_table(model)
        if data.fps != configuration.fps:
            raise UsageError(
                f"frames per second of the tables: the model expects {configuration.fps:g}, found {data.fps:g}."
                " Change one of the two."
            )
        texts = _text_vectors(configuration)
        start = read_weights(initial, kind=KIND) if initial is not None else None
        if objective.vae_share == 0 and start is None:
            raise UsageError("model.vae_share: 0 keeps the VAE of initial weights; give some with --init.")
        vae, denoiser = PrimitiveVAE(configuration), LatentDenoiser(configuration)
        if start is not None:
            _require_same_networks(start, configuration)
            start.load_into(vae, "vae")
            start.load_into(denoiser, "denoiser")
        return DartTraining(
            vae,
            denoiser,
            scaling=feature_scaling(data.train, configuration) if start is None else scaling_of(start),
            texts=texts,
            objective=objective,
            data=data.train,
            latent_std=_kept_latent_std(start) if start is not None and objective.vae_share == 0 else 0.0,
            origin=_origin(configuration, start),
        )


def read_model_table(model: Mapping[str, Any]) -> tuple[DartConfiguration, Objective]:
    """Split the table ``[model]`` into the networks and what they are trained for.

    Raises:
        UsageError: for an unknown key or an impossible value.
    """
    trained_for = {key: value for key, value in model.items() if key in Objective.__struct_fields__}
    networks = {key: value for key, value in model.items() if key not in trained_for}
    try:
        return msgspec.convert(networks, DartConfiguration), msgspec.convert(trained_for, Objective)
    except msgspec.ValidationError as error:
        raise UsageError(f"[model]: {error}.") from error


def _text_vectors(configuration: DartConfiguration) -> TextVectors:
    encoder = text_encoder(configuration.text_encoder)
    if encoder.dimension != configuration.text_dimension:
        raise UsageError(
            f"model.text_dimension: the text encoder '{encoder.name}' has vectors of {encoder.dimension} numbers,"
            f" found {configuration.text_dimension}."
        )
    return TextVectors(encoder)


def _require_same_networks(start: Weights, configuration: DartConfiguration) -> None:
    old = start.configuration(DartConfiguration)
    for name in DartConfiguration.__struct_fields__:
        if name not in FREE_TO_CHANGE and getattr(old, name) != getattr(configuration, name):
            raise InputFileError(
                start.path,
                f"configuration.{name}",
                expected=f"{getattr(configuration, name)}, as in the configuration of this training",
                found=f"{getattr(old, name)}",
                remedy=f"Add --set model.{name}={getattr(old, name)}, or start from other weights.",
            )


def _kept_latent_std(start: Weights) -> float:
    return float(start.require("latent.std", (1,)))


def _origin(configuration: DartConfiguration, start: Weights | None) -> tuple[str, ...]:
    lines = [f"text encoder {configuration.text_encoder} (frozen)"]
    if start is not None:
        lines.append(f"initial weights {start.path.name}, sha256 {start.digest}")
    return tuple(lines)
