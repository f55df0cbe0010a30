"""Distillation: a student learns to walk in one to four network passes where its teacher walks in many.

Source: Salimans and Ho, *Progressive Distillation for Fast Sampling of Diffusion Models*, ICLR 2022. There a
student's step stands for two of its teacher's, and the number of steps is halved again and again. Here one student
stands for all: motions are short and strongly conditioned, and so a single stage is enough.

A recorded motion is noised to the level at which one of the student's passes begins. The teacher walks from there to
the level at which the pass ends, by deterministic steps (DDIM). The student is to say the clean motion with which *its*
one step of DDIM ends in the same state. For a student of one pass that is the end of the teacher's chain. So the same
noise leads both to the same motion, and the student's file is one of an ordinary denoiser of few steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prbench.errors import UsageError
from prbench_adapters.diffusion.configuration import (
    ConditionScaling,
    DenoiserConfiguration,
    EncodedCondition,
    raw_condition_of_items,
)
from prbench_adapters.diffusion.denoiser import Denoiser, FrameDenoiser
from prbench_adapters.diffusion.goal_frame import GoalFrame, seen_condition
from prbench_adapters.diffusion.model import KIND, TextVectors, network, stored_scaling, stored_statistics
from prbench_adapters.diffusion.sampling import MOST_PASSES, CosineSchedule, ddim_factors
from prbench_adapters.diffusion.training import DiffusionTraining, Objective
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.configuration import DEFAULT_STAGES
from prbench_adapters.training.dataset import Goal, collate
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import Weights, origin_of, read_weights

_FREE = frozenset({"diffusion_steps", "dropout"})
"""Keys in which a student may differ from its teacher."""


def require_teacher(configuration: DenoiserConfiguration, start: Weights | None) -> Weights:
    """Refuse a student without a teacher, with too many passes, or of another network than its teacher's.

    Args:
        configuration: The student's; its ``diffusion_steps`` are the passes that it takes.
        start: The teacher's weights.

    Raises:
        UsageError: if there is no teacher, or not fewer passes than it has steps, or more than :data:`MOST_PASSES`.
        InputFileError: if the teacher's network is another one; names the keys to change.
    """
    if start is None:
        raise UsageError("--stage distil: expected the teacher's weights, found none. Add --init FILE.")
    start.require_same(configuration, apart_from=_FREE)
    passes = configuration.diffusion_steps
    steps = start.configuration(DenoiserConfiguration).diffusion_steps
    most = min(MOST_PASSES, steps - 1)
    if steps == 1:
        raise UsageError(f"--init {start.path}: makes a motion in one pass already; there is nothing to distil.")
    if passes > most:
        raise UsageError(
            f"model.diffusion_steps: expected 1 to {most} passes of a student whose teacher has {steps} steps, found"
            f" {passes}. Add --set model.diffusion_steps={most}."
        )
    return start


def student_of(teacher: Denoiser | FrameDenoiser, configuration: DenoiserConfiguration) -> Denoiser | FrameDenoiser:
    """Make a student that starts as its teacher: each pass at the noise level of the teacher's step where it begins.

    Args:
        teacher: Of more diffusion steps.
        configuration: The student's.
    """
    schedule = CosineSchedule(teacher.configuration.diffusion_steps)
    kept = torch.as_tensor(schedule.kept_steps(configuration.diffusion_steps, "trailing"))
    if isinstance(teacher, FrameDenoiser):
        frames = FrameDenoiser(configuration)
        frames.take_steps(teacher, kept)
        return frames
    student = Denoiser(configuration)
    student.take_steps(teacher, kept)
    return student


def teacher_walks(total: int, passes: int, steps: int) -> Int[np.ndarray, "passes walked"]:
    """The teacher's steps within each pass of the student, the noisiest first; the cleanest pass is the first row.

    Args:
        total: Diffusion steps of the teacher.
        passes: Of the student; fewer.
        steps: Steps that the teacher takes from noise to motion; every pass has the same number, at least one.
    """
    ends = np.concatenate([[-1], CosineSchedule(total).kept_steps(passes, "trailing")])
    gaps = np.diff(ends)
    walked = max(1, min(steps // passes, int(gaps.min())))
    return ends[:-1, None] + np.arange(walked, 0, -1) * gaps[:, None] // walked


class Distillation(DiffusionTraining):
    """A student with its frozen teacher; its losses are those of a training, against the teacher's motions.

    Args:
        denoiser: The student in its state before the first step.
        teacher: With trained weights.
        statistics: The teacher's.
        scaling: The teacher's.
        texts: Vectors of the captions.
        objective: Weights of the losses.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        denoiser: Denoiser | FrameDenoiser,
        teacher: Denoiser | FrameDenoiser,
        *,
        statistics: tuple[Float[Tensor, " features"], Float[Tensor, " features"]],
        scaling: ConditionScaling | None,
        texts: TextVectors,
        objective: Objective,
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__(
            denoiser, statistics=statistics, scaling=scaling, texts=texts, objective=objective, origin=origin
        )
        self.teacher = teacher.eval().requires_grad_(False)
        schedule = CosineSchedule(teacher.configuration.diffusion_steps)
        own = CosineSchedule(denoiser.configuration.diffusion_steps)
        walks = teacher_walks(len(schedule), len(own), objective.teacher_steps)
        levels = schedule.alphas_cumprod[walks]
        arrived = np.concatenate([[1.0], levels[:-1, 0]])
        of_clean, of_state = ddim_factors(levels, np.column_stack([levels[:, 1:], arrived]))
        own_of_clean, own_of_state = ddim_factors(own.alphas_cumprod, own.alphas_cumprod_previous)
        self.walks: Tensor
        self.of_clean: Tensor
        self.of_state: Tensor
        self.own_of_clean: Tensor
        self.own_of_state: Tensor
        for name, values in {
            "walks": walks,
            # A pass begins at the teacher's level, which rounding to whole steps moves a little from the student's own.
            "signal": np.sqrt(levels[:, 0]),
            "noise": np.sqrt(1.0 - levels[:, 0]),
            "of_clean": of_clean,
            "of_state": of_state,
            "own_of_clean": own_of_clean,
            "own_of_state": own_of_state,
        }.items():
            tensor = torch.as_tensor(values)
            self.register_buffer(name, tensor.float() if tensor.is_floating_point() else tensor, persistent=False)

    def train(self, mode: bool = True) -> Distillation:
        """Switch the student's mode; the teacher stays in evaluation."""
        super().train(mode)
        self.teacher.eval()
        return self

    def forward(self, batch: MotionBatch, step: int) -> dict[str, Tensor]:
        """The loss of the student's estimate against the one that leads to where the teacher arrives, and its parts."""
        draw = self.draw(batch, step)
        condition = self.condition(batch, draw.without_text)
        with torch.no_grad():
            noisy = self.noisy(self.standardised(batch, condition), draw)
            wanted = self.wanted(noisy, draw.step, batch, condition)
        predicted = self.denoiser(noisy, draw.step, condition, batch.n_frames)
        with torch.autocast(noisy.device.type, enabled=False):  # joints are cumulative sums: float32 only
            taught = replace(batch, joints=self.joints_of(wanted, batch, condition))
            return self.losses_of(predicted.float(), wanted, taught, condition)

    def wanted(
        self,
        noisy: Float[Tensor, "batch frames features"],
        own_step: Int[Tensor, " batch"],
        batch: MotionBatch,
        condition: EncodedCondition,
    ) -> Float[Tensor, "batch frames features"]:
        """The clean estimate with which the student's step ends where the teacher arrives; standardised features."""
        state = noisy
        for place in range(self.walks.shape[1]):
            clean = self.teacher(state, self.walks[own_step, place], condition, batch.n_frames).float()
            state = _factor(self.of_clean, own_step, place) * clean + _factor(self.of_state, own_step, place) * state
        ahead = state - _factor(self.own_of_state, own_step) * noisy
        return (ahead / _factor(self.own_of_clean, own_step)).masked_fill(batch.padding[..., None], 0.0)


def _factor(factors: Tensor, step: Int[Tensor, " batch"], place: int | None = None) -> Float[Tensor, "batch 1 1"]:
    """The factor of each sequence's step, to multiply features by."""
    row = factors[step] if place is None else factors[step, place]
    return row[:, None, None]


FREE_TO_CHANGE = frozenset(
    {"goal", "injection", "dropped", "condition_scaling", "dropout", "max_frames", "smoothed", "uniform_skeleton"}
)
"""Keys that fine-tuning may set otherwise than the weights that it starts from."""
DISTIL = "distil"
"""The stage in which a student learns from trained weights to make a motion in a few passes."""
_TOGETHER = 64  # sequences whose features are measured at once
_LEAST_FEATURE_STD = 0.05
"""Metres, or of a unit vector: bones that hardly turn are not blown up."""
_LEAST_CONDITION_STD = 0.01


@dataclass(frozen=True)
class DiffusionTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name: str
    goals: tuple[str, ...]
    """Kinds of goal that its models may have once they are fine-tuned."""
    configurations: str
    """Import name of the package with the method's ``<name>-<configuration>.toml``."""
    stages: tuple[str, ...] = DEFAULT_STAGES
    """Names that ``--stage`` may have."""

    def build(
        self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str
    ) -> TrainingModule:
        """Make the denoiser in its state before the first step.

        Statistics of features, and of the condition vector, come from the initial weights where these have them, else
        from the training split (docs/specification/pr-model.md#data-and-features).

        Args:
            model: Keys of :class:`DenoiserConfiguration` and of :class:`Objective`.
            data: The training split.
            initial: Weights to start from; parameters that they lack start as the network makes them. Of a student the
                teacher's, which it has completely.
            stage: ``pretrain``, ``finetune`` or, where there are students, ``distil``.

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
        if stage == DISTIL:
            return self._student(configuration, objective, texts, require_teacher(configuration, start))
        if start is not None:
            _require_fitting_start(configuration, start)
        statistics, scaling = _scales(configuration, start, data)
        denoiser = network(configuration)
        if start is not None:
            # Fill a denoiser with trained weights; the parts that only the new configuration has keep their own start.
            old = start.configuration(DenoiserConfiguration)
            trained = network(old)
            start.load_into(trained, "denoiser")
            # Layers of a new condition are missing in the file and keep their start at zero.
            denoiser.load_state_dict(trained.state_dict(), strict=False)
        return DiffusionTraining(
            denoiser,
            statistics=statistics,
            scaling=scaling,
            texts=texts,
            objective=objective,
            origin=(texts.origin, *origin_of(start)),
        )

    def _student(
        self, configuration: DenoiserConfiguration, objective: Objective, texts: TextVectors, start: Weights
    ) -> Distillation:
        """The student of the teacher in a weights file, with the teacher's scales."""
        teacher = network(start.configuration(DenoiserConfiguration))
        start.load_into(teacher, "denoiser")
        return Distillation(
            student_of(teacher, configuration),
            teacher,
            statistics=stored_statistics(start, configuration),
            scaling=stored_scaling(start, configuration),
            texts=texts,
            objective=objective,
            origin=(
                texts.origin,
                f"distilled from {start.path.name}, sha256 {start.digest}, of {teacher.configuration.diffusion_steps}"
                f" diffusion steps; network passes a motion: {configuration.diffusion_steps}",
            ),
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


def _require_fitting_start(configuration: DenoiserConfiguration, start: Weights) -> None:
    """Refuse initial weights that a model cannot continue from.

    Raises:
        InputFileError: if the weights are of another architecture, or were trained for another goal.
    """
    old = start.configuration(DenoiserConfiguration)
    # Pre-training without a goal leaves the kind of goal open; afterwards the condition's layers are sized for it.
    fixed_by_goal = frozenset() if old.goal == "none" else {"goal", "injection"}
    start.require_same(configuration, apart_from=FREE_TO_CHANGE - fixed_by_goal)


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


_Statistics = tuple[torch.Tensor, torch.Tensor]
"""Mean and standard deviation."""


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
        for start in range(0, len(data.train), _TOGETHER):
            batch = collate([data.train[index] for index in range(start, min(start + _TOGETHER, len(data.train)))])
            raw = raw_condition_of_items(batch, cast(Goal, configuration.goal))
            features.append(GoalFrame.of(raw).encode(batch.joints, batch.fps)[~batch.padding])
            conditions.append(seen_condition(raw))
        stacked = torch.cat(features)
        std = stacked.std(dim=0)
        std = std.clamp_min(_LEAST_FEATURE_STD)
        seen = torch.cat(conditions)
        scaling = ConditionScaling.of(configuration, seen.mean(dim=0), seen.std(dim=0).clamp_min(_LEAST_CONDITION_STD))
        return (stacked.mean(dim=0), std), scaling
    if start is not None:
        features = stored_statistics(start, configuration)
    else:
        found = data.train.statistics()
        features = torch.as_tensor(found.mean), torch.as_tensor(found.std)
    if own is None:
        return features, None
    return features, ConditionScaling.of(configuration, torch.as_tensor(own[0]), torch.as_tensor(own[1]))
