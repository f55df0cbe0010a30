"""The task of ``prbench train`` for MDM, DNO and P&R: a denoiser in its state before the first step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch

from prbench.errors import UsageError
from prbench_adapters.diffusion.configuration import ConditionScaling, DenoiserConfiguration
from prbench_adapters.diffusion.goal_frame import GoalFrame, seen_condition
from prbench_adapters.diffusion.model import KIND, TextVectors, network, stored_scaling, stored_statistics
from prbench_adapters.diffusion.training import DiffusionTraining, Objective, raw_condition_of_items
from prbench_adapters.training.dataset import Goal, collate
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import Weights, origin_of, read_weights

# Keys that fine-tuning may set otherwise than the weights that it starts from.
FREE_TO_CHANGE = frozenset(
    {"goal", "injection", "dropped", "condition_scaling", "dropout", "max_frames", "smoothed", "uniform_skeleton"}
)
_TOGETHER = 64  # sequences whose features are measured at once
# Metres, or of a unit vector: bones that hardly turn are not blown up.
_LEAST_FEATURE_STD = 0.05
_LEAST_CONDITION_STD = 0.01


@dataclass(frozen=True)
class DiffusionTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`).

    Attributes:
        goals: Kinds of goal that its models may have once they are fine-tuned.
        configurations: Import name of the package with the method's ``<name>-<configuration>.toml``.
    """

    name: str
    goals: tuple[str, ...]
    configurations: str

    def build(
        self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str
    ) -> TrainingModule:
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
        configuration, objective = split_model_table(model, DenoiserConfiguration, Objective)
        allowed = ("none", *self.goals) if stage == "pretrain" or not self.goals else self.goals
        if configuration.goal not in allowed:
            problem = f"expected model.goal to be {' or '.join(allowed)}, found '{configuration.goal}'."
            raise UsageError(f"--method {self.name} --stage {stage}: {problem}")
        data.require_fit("the model", configuration)
        # Prime-and-reach tables keep everybody's own bones; HumanML3D alone comes on one skeleton, and has no goals.
        if configuration.uniform_skeleton and configuration.goal != "none":
            for table in data.train.tables:
                if not table.info.dataset.endswith("humanml3d"):
                    raise UsageError(
                        f"model.uniform_skeleton: expected bodies on HumanML3D's skeleton, found {table.info.dataset},"
                        " whose people have bones of their own. Leave the key out, or train on a HumanML3D corpus"
                        " alone."
                    )
        texts = TextVectors.of_model(configuration.text_encoder, configuration.text_dimension)
        start = read_weights(initial, kind=KIND) if initial is not None else None
        if start is not None:
            # Pre-training without a goal leaves its kind open; afterwards the condition's layers are sized for it.
            old = start.configuration(DenoiserConfiguration)
            fixed_by_goal = frozenset() if old.goal == "none" else {"goal", "injection"}
            start.require_same(configuration, apart_from=FREE_TO_CHANGE - fixed_by_goal)
        statistics, scaling = _scales(configuration, start, data)
        denoiser = network(configuration)
        if start is not None:
            # Fill a denoiser with trained weights; the parts that only the new configuration has keep their own start.
            trained = network(start.configuration(DenoiserConfiguration))
            start.load_into(trained, "denoiser")
            # Layers of a new condition are missing in the file and keep their start at zero.
            denoiser.load_state_dict(trained.state_dict(), strict=False)
        about: dict[str, Any] = {"texts": texts, "objective": objective, "origin": (texts.origin, *origin_of(start))}
        return DiffusionTraining(denoiser, statistics=statistics, scaling=scaling, **about)


# Mean and standard deviation.
_Statistics = tuple[torch.Tensor, torch.Tensor]


def _scales(
    configuration: DenoiserConfiguration, start: Weights | None, data: TrainingData
) -> tuple[_Statistics, ConditionScaling | None]:
    """Scales of features and of the condition vector: those of the initial weights where they have them."""
    # Asked first, because it refuses data without goals, whatever we start from.
    own = None if configuration.goal == "none" else data.train.condition_statistics(configuration.goal)
    if start is not None and (configuration.goal == "none" or start.part("condition")):
        return stored_statistics(start, configuration), stored_scaling(start, configuration)
    if configuration.features == "goal-frame":
        # Scales of goal-frame features; no deviation is below 0.05.
        features = []
        conditions = []
        for first in range(0, len(data.train), _TOGETHER):
            batch = collate([data.train[index] for index in range(first, min(first + _TOGETHER, len(data.train)))])
            raw = raw_condition_of_items(batch, cast(Goal, configuration.goal))
            features.append(GoalFrame.of(raw).encode(batch.joints, batch.fps)[~batch.padding])
            conditions.append(seen_condition(raw))
        stacked = torch.cat(features)
        seen = torch.cat(conditions)
        scaling = ConditionScaling.of(configuration, seen.mean(dim=0), seen.std(dim=0).clamp_min(_LEAST_CONDITION_STD))
        return (stacked.mean(dim=0), stacked.std(dim=0).clamp_min(_LEAST_FEATURE_STD)), scaling
    if start is not None:
        features = stored_statistics(start, configuration)
    else:
        found = data.train.statistics()
        features = torch.as_tensor(found.mean), torch.as_tensor(found.std)
    if own is None:
        return features, None
    return features, ConditionScaling.of(configuration, torch.as_tensor(own[0]), torch.as_tensor(own[1]))
