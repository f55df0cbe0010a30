"""Training tasks of the methods with a denoiser: from a ``[model]`` table, data and initial weights to a module."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from prbench.contract import Adapter
from prbench.errors import UsageError
from prbench.representation.features import N_FEATURES
from prbench.training.task import TrainingData, split_model_table
from prbench.training.weights import Weights, origin_of, read_weights
from prbench_adapters.diffusion.condition import ConditionScaling
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.model import KIND, MotionModel, TextVectors, stored_scaling
from prbench_adapters.diffusion.training import DiffusionTraining, Objective

FREE_TO_CHANGE = frozenset(
    {"goal", "injection", "dropped", "condition_scaling", "dropout", "max_frames", "uniform_skeleton"}
)
"""Keys that fine-tuning may set otherwise than the weights that it starts from."""


@dataclass(frozen=True)
class DiffusionTask:
    """A training task (:class:`prbench.training.task.TrainingTask`)."""

    name: str
    goals: tuple[str, ...]
    """Kinds of goal that its models may have once they are fine-tuned."""
    configurations: str
    """Import name of the package with the method's ``<name>-<configuration>.toml``."""
    validating: Callable[[MotionModel], Adapter]
    """Makes the adapter that validation asks for motions, from the network as it is then."""

    def build(
        self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str
    ) -> DiffusionTraining:
        """Make the denoiser in its state before the first step.

        Statistics of features, and of the condition vector, come from the initial weights where these have them, else
        from the training split (docs/specification/pr-model.md#data-and-features).

        Args:
            model: Keys of :class:`DenoiserConfiguration` and of :class:`Objective`.
            data: The training split.
            initial: Weights to start from; parameters that they lack start as the network makes them.
            stage: ``pretrain`` or ``finetune``.

        Raises:
            UsageError: if the table does not describe such a model, or the data do not fit it.
            InputFileError: if the initial weights do not fit it.
        """
        configuration, objective = read_model_table(model)
        self._require_goal(configuration, stage)
        data.require_fit(
            "the model",
            representation=configuration.representation,
            fps=configuration.fps,
            max_frames=configuration.max_frames,
        )
        _require_one_skeleton(configuration, data)
        texts = TextVectors.of_model(configuration.text_encoder, configuration.text_dimension)
        start = read_weights(initial, kind=KIND) if initial is not None else None
        denoiser = Denoiser(configuration)
        if start is not None:
            _continue_from(denoiser, start)
        return DiffusionTraining(
            denoiser,
            statistics=_statistics(start, data),
            scaling=_scaling(configuration, start, data),
            texts=texts,
            objective=objective,
            validating=self.validating,
            origin=(texts.origin, *origin_of(start)),
        )

    def _require_goal(self, configuration: DenoiserConfiguration, stage: str) -> None:
        allowed = ("none", *self.goals) if stage == "pretrain" or not self.goals else self.goals
        if configuration.goal not in allowed:
            raise UsageError(
                f"--method {self.name} --stage {stage}: expected model.goal to be {' or '.join(allowed)},"
                f" found '{configuration.goal}'."
            )


def read_model_table(model: Mapping[str, Any]) -> tuple[DenoiserConfiguration, Objective]:
    """Split the table ``[model]`` into the network and what it is trained for.

    Raises:
        UsageError: for an unknown key or a value of a wrong kind.
    """
    return split_model_table(model, DenoiserConfiguration, Objective)


def _continue_from(denoiser: Denoiser, start: Weights) -> None:
    """Fill a denoiser with trained weights; the parts that only the new configuration has keep their own start.

    Raises:
        InputFileError: if the weights are of another architecture, or were trained for another goal.
    """
    old = start.configuration(DenoiserConfiguration)
    # Pre-training without a goal leaves the kind of goal open; afterwards the condition's layers are sized for it.
    fixed_by_goal = frozenset() if old.goal == "none" else {"goal", "injection"}
    start.require_same(denoiser.configuration, apart_from=FREE_TO_CHANGE - fixed_by_goal)
    trained = Denoiser(old)
    start.load_into(trained, "denoiser")
    # Layers of a new condition are missing in the file and keep their start at zero.
    denoiser.load_state_dict(trained.state_dict(), strict=False)


def _require_one_skeleton(configuration: DenoiserConfiguration, data: TrainingData) -> None:
    """Prime-and-reach tables keep everybody's own bones; HumanML3D alone comes on one skeleton, and has no goals."""
    if not configuration.uniform_skeleton or configuration.goal == "none":
        return
    for table in data.train.tables:
        if not table.info.dataset.endswith("humanml3d"):
            raise UsageError(
                f"model.uniform_skeleton: expected bodies on HumanML3D's skeleton, found {table.info.dataset}, whose"
                " people have bones of their own. Leave the key out, or train on a HumanML3D corpus alone."
            )


def _statistics(start: Weights | None, data: TrainingData) -> tuple[torch.Tensor, torch.Tensor]:
    if start is not None:
        shape = (N_FEATURES,)
        return start.require("statistics.mean", shape), start.require("statistics.std", shape)
    found = data.train.statistics()
    return torch.as_tensor(found.mean), torch.as_tensor(found.std)


def _scaling(
    configuration: DenoiserConfiguration, start: Weights | None, data: TrainingData
) -> ConditionScaling | None:
    if configuration.goal == "none":
        return None
    found = data.train.condition_statistics(configuration.goal)  # refuses data without goals, whatever we start from
    if start is not None and start.part("condition"):
        return stored_scaling(start, configuration)
    return ConditionScaling.of(configuration, torch.as_tensor(found.mean), torch.as_tensor(found.std))
