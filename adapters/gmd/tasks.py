"""The training task ``gmd``: from a ``[model]`` table, data and initial weights to a module to train."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from prbench.representation.statistics import StatisticsAccumulator
from prbench.training.model_table import split_model_table
from prbench.training.task import TrainingData
from prbench.training.weights import origin_of, read_weights
from prbench_adapters.diffusion.text_vectors import TextVectors
from prbench_adapters.gmd.configuration import GMDConfiguration
from prbench_adapters.gmd.features import FeatureSpace, emphasis_projection, with_absolute_root
from prbench_adapters.gmd.model import KIND, GMDNetworks, stored_space
from prbench_adapters.gmd.training import GMDTraining, Objective

FREE_TO_CHANGE = frozenset({"max_frames", "uniform_skeleton"})
"""What fine-tuning may set otherwise than the weights that it starts from."""


class GMDTask:
    """A training task (:class:`prbench.training.task.TrainingTask`); both stages of training learn from text alone."""

    name = "gmd"
    configurations = "prbench_adapters.gmd"

    def build(
        self,
        model: Mapping[str, Any],
        *,
        data: TrainingData,
        initial: Path | None,
        stage: str,  # noqa: ARG002
    ) -> GMDTraining:
        """Make both networks in their state before the first step.

        Statistics and projection come from the initial weights where there are some.

        Args:
            model: Keys of :class:`GMDConfiguration` and of :class:`Objective`.
            data: The training split.
            initial: Weights to start from.
            stage: ``pretrain`` or ``finetune``; the same networks learn in both.

        Raises:
            UsageError: if the table does not describe such networks, or the data do not fit them.
            InputFileError: if the initial weights do not fit them.
        """
        configuration, objective = read_model_table(model)
        data.require_fit(
            "the model",
            representation=configuration.representation,
            fps=configuration.fps,
            max_frames=configuration.max_frames,
        )
        texts = TextVectors.of_model(configuration.text_encoder, configuration.text_dimension)
        start = read_weights(initial, kind=KIND) if initial is not None else None
        networks = GMDNetworks(configuration)
        if start is not None:
            start.require_same(configuration, apart_from=FREE_TO_CHANGE)
            start.load_into(networks, "networks")
        space = stored_space(start) if start is not None else _space_of(data, configuration)
        origin = (texts.origin, *origin_of(start))
        return GMDTraining(networks, space=space, texts=texts, objective=objective, origin=origin)


def read_model_table(model: Mapping[str, Any]) -> tuple[GMDConfiguration, Objective]:
    """Split the table ``[model]`` into the networks and what they are trained for.

    Raises:
        UsageError: for an unknown key or a value of a wrong kind.
    """
    return split_model_table(model, GMDConfiguration, Objective)


def _space_of(data: TrainingData, configuration: GMDConfiguration) -> FeatureSpace:
    """Statistics of the training split with absolute roots; x and z of the root share one deviation."""
    accumulator = StatisticsAccumulator()
    for index in range(len(data.train)):
        accumulator.add(with_absolute_root(torch.tensor(data.train[index].features)).numpy())
    found = accumulator.result()
    projection = emphasis_projection(configuration.emphasis)
    return FeatureSpace.of(torch.as_tensor(found.mean), torch.as_tensor(found.std), projection)
