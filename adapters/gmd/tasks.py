"""The training task ``gmd``: from a ``[model]`` table, data and initial weights to a module to train."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import torch

from prbench.errors import InputFileError, UsageError
from prbench.representation.statistics import StatisticsAccumulator
from prbench.text import text_encoder
from prbench.training.task import TrainingData
from prbench.training.weights import Weights, read_weights
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
        texts = _text_vectors(configuration)
        start = read_weights(initial, kind=KIND) if initial is not None else None
        networks = GMDNetworks(configuration)
        if start is not None:
            _require_same_networks(configuration, start)
            start.load_into(networks, "networks")
        space = stored_space(start) if start is not None else _space_of(data, configuration)
        origin = _origin(configuration, start)
        return GMDTraining(networks, space=space, texts=texts, objective=objective, origin=origin)


def read_model_table(model: Mapping[str, Any]) -> tuple[GMDConfiguration, Objective]:
    """Split the table ``[model]`` into the networks and what they are trained for.

    Raises:
        UsageError: for an unknown key or a value of a wrong kind.
    """
    trained_for = {key: value for key, value in model.items() if key in Objective.__struct_fields__}
    networks = {key: value for key, value in model.items() if key not in trained_for}
    try:
        return msgspec.convert(networks, GMDConfiguration), msgspec.convert(trained_for, Objective)
    except msgspec.ValidationError as error:
        raise UsageError(f"[model]: {error}.") from error


def _space_of(data: TrainingData, configuration: GMDConfiguration) -> FeatureSpace:
    """Statistics of the training split with absolute roots; x and z of the root share one deviation."""
    accumulator = StatisticsAccumulator()
    for index in range(len(data.train)):
        accumulator.add(with_absolute_root(torch.tensor(data.train[index].features)).numpy())
    found = accumulator.result()
    projection = emphasis_projection(configuration.emphasis)
    return FeatureSpace.of(torch.as_tensor(found.mean), torch.as_tensor(found.std), projection)


def _require_same_networks(configuration: GMDConfiguration, start: Weights) -> None:
    old = start.configuration(GMDConfiguration)
    for name in GMDConfiguration.__struct_fields__:
        if name not in FREE_TO_CHANGE and getattr(old, name) != getattr(configuration, name):
            raise InputFileError(
                start.path,
                f"configuration.{name}",
                expected=f"{getattr(configuration, name)}, as in the configuration of this training",
                found=f"{getattr(old, name)}",
                remedy=f"Add --set model.{name}={getattr(old, name)}, or start from other weights.",
            )


def _text_vectors(configuration: GMDConfiguration) -> TextVectors:
    encoder = text_encoder(configuration.text_encoder)
    if encoder.dimension != configuration.text_dimension:
        raise UsageError(
            f"model.text_dimension: the text encoder '{encoder.name}' has vectors of {encoder.dimension} numbers,"
            f" found {configuration.text_dimension}."
        )
    return TextVectors(encoder)


def _origin(configuration: GMDConfiguration, start: Weights | None) -> tuple[str, ...]:
    lines = [f"text encoder {configuration.text_encoder} (frozen)"]
    if start is not None:
        lines.append(f"initial weights {start.path.name}, sha256 {start.digest}")
    return tuple(lines)
