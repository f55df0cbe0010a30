"""The training task ``dart``: from a ``[model]`` table, data and initial weights to a module to train."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from prbench.errors import UsageError
from prbench_adapters.dart.configuration import DartConfiguration
from prbench_adapters.dart.losses import Objective
from prbench_adapters.dart.model import KIND, scaling_of
from prbench_adapters.dart.networks import LatentDenoiser, PrimitiveVAE
from prbench_adapters.dart.training import DartTraining
from prbench_adapters.dart.windows import feature_scaling
from prbench_adapters.diffusion.model import TextVectors
from prbench_adapters.training.task import TrainingData, split_model_table
from prbench_adapters.training.weights import origin_of, read_weights

FREE_TO_CHANGE = frozenset({"dropout", "uniform_skeleton"})
"""Keys that fine-tuning may set otherwise than the weights that it starts from."""


class DartTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`)."""

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
        # A wrong size of text vectors shows before any statistics are computed.
        texts = TextVectors.of_model(configuration.text_encoder, configuration.text_dimension)
        start = read_weights(initial, kind=KIND) if initial is not None else None
        if objective.vae_share == 0 and start is None:
            raise UsageError("model.vae_share: 0 keeps the VAE of initial weights; give some with --init.")
        vae = PrimitiveVAE(configuration)
        denoiser = LatentDenoiser(configuration)
        if start is not None:
            start.require_same(configuration, apart_from=FREE_TO_CHANGE)
            start.load_into(vae, "vae")
            start.load_into(denoiser, "denoiser")
        return DartTraining(
            vae,
            denoiser,
            scaling=feature_scaling(data.train, configuration) if start is None else scaling_of(start),
            texts=texts,
            objective=objective,
            data=data.train,
            latent_std=float(start.require("latent.std", (1,)))
            if start is not None and objective.vae_share == 0
            else 0.0,
            origin=(texts.origin, *origin_of(start)),
        )


def read_model_table(model: Mapping[str, Any]) -> tuple[DartConfiguration, Objective]:
    """Split the table ``[model]`` into the networks and what they are trained for.

    Raises:
        UsageError: for an unknown key or an impossible value.
    """
    return split_model_table(model, DartConfiguration, Objective)
