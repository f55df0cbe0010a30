"""The training task ``wandr``: from a ``[model]`` table, data and initial weights to a module to train."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float

from prbench.errors import UsageError
from prbench_adapters.training import MotionBatch, collate
from prbench_adapters.training.task import TrainingData, split_model_table
from prbench_adapters.training.weights import Weights, origin_of, read_weights
from prbench_adapters.wandr.network import KIND, Standardisation, WandrConfiguration, WandrNetwork, network_of
from prbench_adapters.wandr.recordings import Recordings, starts
from prbench_adapters.wandr.training import Objective, WandrTraining

FREE_TO_CHANGE = frozenset({"dropout", "original_deviation", "most_speed"})
"""Keys that fine-tuning may set otherwise than the weights that it starts from."""

_MOST_MOTIONS = 4096
"""Number of motions that statistics are made from, spread evenly over the training split."""
_TOGETHER = 64
_LEAST_SEEN = 0.02
_LEAST_DELTA = 1e-3
"""Smallest deviations of a state's numbers and of a change's (metres, numbers of a matrix). Some hardly vary, such as a
hip's rotation in recordings of one person; whatever is a little different later must not look enormous."""


@dataclass(frozen=True)
class WandrTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name: str = "wandr"
    configurations: str = "prbench_adapters.wandr"

    def build(
        self,
        model: Mapping[str, Any],
        *,
        data: TrainingData,
        initial: Path | None,
        stage: str,  # noqa: ARG002 - motions say themselves whether they have goals
    ) -> WandrTraining:
        """Make the network in its state before the first step.

        Args:
            model: Keys of :class:`WandrConfiguration` and of :class:`Objective`.
            data: The training split; tables with goals, corpora without, or both.
            initial: Weights to start from; their statistics are kept.
            stage: ``pretrain`` or ``finetune``, which differ in their data alone.

        Raises:
            UsageError: if the table does not describe such a network.
            InputFileError: if the initial weights do not fit it.
        """
        configuration, objective = read_model_table(model)
        if initial is not None:
            start = read_weights(initial, kind=KIND)
            return WandrTraining(_continued(configuration, start), objective, origin_of(start))
        network = WandrNetwork(configuration)
        _take_statistics(network, data)
        return WandrTraining(network, objective)


def read_model_table(model: Mapping[str, Any]) -> tuple[WandrConfiguration, Objective]:
    """Split the table ``[model]`` into the network and what it is trained for.

    Raises:
        UsageError: for an unknown key or a value of a wrong kind.
    """
    return split_model_table(model, WandrConfiguration, Objective)


def _take_statistics(network: WandrNetwork, data: TrainingData) -> None:
    """Standardise by the training split.

    Raises:
        UsageError: if no motion has three frames at the network's rate.
    """
    seen = []
    deltas = []
    for batch in _batches(data):
        recordings = Recordings.of(batch, network.configuration.fps)
        places = starts(recordings, 1)
        seen.append(recordings.states(places).seen())
        deltas.append(recordings.deltas(places))
    if not sum(len(values) for values in deltas):
        raise UsageError("the training split: expected motions of three frames or more, found none.")
    _set(network.seen, torch.cat(seen), _LEAST_SEEN)
    _set(network.delta, torch.cat(deltas), _LEAST_DELTA)


def _batches(data: TrainingData) -> Iterator[MotionBatch]:
    train = data.train
    chosen = range(0, len(train), -(-len(train) // _MOST_MOTIONS))
    # Similar lengths together, so that little is computed for padding.
    order = sorted(chosen, key=lambda place: int(train.lengths[place]))
    for first in range(0, len(order), _TOGETHER):
        yield collate([train[place] for place in order[first : first + _TOGETHER]])


def _set(into: Standardisation, values: Float[torch.Tensor, "places size"], least: float) -> None:
    values = values.double()
    into.mean.copy_(values.mean(0))
    into.std.copy_(values.std(0, correction=0).clamp_min(least))


def _continued(configuration: WandrConfiguration, start: Weights) -> WandrNetwork:
    """The network of a file, for a configuration that may differ in a few points.

    Raises:
        InputFileError: if it differs in others, or the file is damaged.
    """
    start.require_same(configuration, apart_from=FREE_TO_CHANGE)
    network = WandrNetwork(configuration)
    # Through a network of the file's own configuration, which checks every shape.
    network.load_state_dict(network_of(start).state_dict())
    return network
