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

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prbench.contract import Adapter
from prbench.errors import UsageError
from prbench_adapters.diffusion.condition import ConditionScaling, EncodedCondition
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.frame_denoiser import FrameDenoiser
from prbench_adapters.diffusion.model import MotionModel, TextVectors
from prbench_adapters.diffusion.sampling import MOST_PASSES, CosineSchedule, ddim_factors
from prbench_adapters.diffusion.training import DiffusionTraining, Objective
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.weights import Weights

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
        validating: Makes the adapter that validation asks for motions.
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
        validating: Callable[[MotionModel], Adapter],
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__(
            denoiser,
            statistics=statistics,
            scaling=scaling,
            texts=texts,
            objective=objective,
            validating=validating,
            origin=origin,
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
