"""Training of denoisers: on text alone, or on text, initial state and goal.

Source: docs/specification/pr-model.md#training.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import torch
from jaxtyping import Bool, Float, Int

from prbench.contract import Adapter
from prbench.representation.tensors import decode
from prbench.training import MotionBatch
from prbench.training.task import TrainingModule
from prbench.training.weights import representation_entry
from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.condition_vector import ConditionScaling, raw_condition
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.losses import Objective, losses
from prbench_adapters.diffusion.model import KIND, MotionModel
from prbench_adapters.diffusion.schedule import CosineSchedule
from prbench_adapters.diffusion.text_vectors import TextVectors


@dataclass(frozen=True)
class Draw:
    """What is random in one training step."""

    step: Int[torch.Tensor, " batch"]
    """Index t of the diffusion step of each sequence, uniform unless the objective asks for more noise."""
    without_text: Bool[torch.Tensor, " batch"]
    """Whose text is hidden, so that guidance has an unconditional model; the condition vector never is."""
    noise: Float[torch.Tensor, "batch frames 263"]


class DiffusionTraining(TrainingModule):
    """A denoiser with its losses.

    Args:
        denoiser: In its state before the first step.
        statistics: Mean and standard deviation (263,) that features are standardised with.
        scaling: Of the condition vector; None for a model without a goal.
        texts: Vectors of the captions.
        objective: Weights of the losses.
        validating: Makes the adapter that validation asks for motions.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        denoiser: Denoiser,
        *,
        statistics: tuple[Float[torch.Tensor, " 263"], Float[torch.Tensor, " 263"]],
        scaling: ConditionScaling | None,
        texts: TextVectors,
        objective: Objective,
        validating: Callable[[MotionModel], Adapter],
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.denoiser, self.scaling, self.texts = denoiser, scaling, texts
        self.objective, self.validating, self.origin = objective, validating, origin
        schedule = CosineSchedule(denoiser.configuration.diffusion_steps)
        alphas_cumprod = torch.as_tensor(schedule.alphas_cumprod)
        self.mean: torch.Tensor
        self.std: torch.Tensor
        self.signal: torch.Tensor
        self.noise: torch.Tensor
        for name, values in {
            "mean": statistics[0],
            "std": statistics[1],
            "signal": alphas_cumprod.sqrt().float(),
            "noise": (1 - alphas_cumprod).sqrt().float(),
        }.items():  # a resumed run makes them anew, so they are no part of its checkpoints
            self.register_buffer(name, values, persistent=False)

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """The loss of one batch with noise of a random strength, and its parts.

        Returns:
            ``loss`` and its parts (:func:`prbench_adapters.diffusion.losses.losses`).
        """
        draw = self.draw(batch, step)
        padding = batch.padding
        clean = ((batch.features - self.mean) / self.std).masked_fill(padding[..., None], 0.0)
        signal, noise = self.signal[draw.step][:, None, None], self.noise[draw.step][:, None, None]
        condition = self.condition(batch, draw.without_text)
        predicted = self.denoiser(signal * clean + noise * draw.noise, draw.step, condition, batch.n_frames)
        with torch.autocast(clean.device.type, enabled=False):  # joints are cumulative sums: float32 only
            predicted = predicted.float()
            joints = decode(predicted * self.std + self.mean)
            return losses(self.objective, predicted, clean, joints, batch.joints, padding)

    def draw(self, batch: MotionBatch, step: int) -> Draw:
        """What step ``step`` draws for a batch of this shape: a function of seed, step and rank."""
        generator, device = self.generator(step), batch.features.device
        n = len(batch.features)
        t = torch.randint(len(self.signal), (n,), generator=generator)
        without_text = torch.rand(n, generator=generator) < self.objective.text_drop
        noise = torch.randn(batch.features.shape, generator=generator)
        if self.objective.noisiest_share:
            noisiest = len(self.signal) - 1 - torch.randint(-(-len(self.signal) // 6), (n,), generator=generator)
            t = torch.where(torch.rand(n, generator=generator) < self.objective.noisiest_share, noisiest, t)
        return Draw(*(values.to(device, non_blocking=True) for values in (t, without_text, noise)))

    def condition(self, batch: MotionBatch, without_text: Bool[torch.Tensor, " batch"]) -> EncodedCondition:
        """What the network is told about a batch: the text unless hidden, the scaled condition vector always."""
        device = batch.features.device
        text, padding = (values.to(device, non_blocking=True) for values in self.texts(batch.text))
        text = text.masked_fill(without_text[:, None, None], 0.0)
        return EncodedCondition(text, padding, self._vector(batch))

    def _vector(self, batch: MotionBatch) -> Float[torch.Tensor, "batch size"] | None:
        if self.scaling is None:
            return None
        goal = batch.goal_joints if self.denoiser.configuration.goal == "pose" else batch.goal_location
        return self.scaling(raw_condition(batch.initial_joints, batch.previous_joints, goal, batch.fps))

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """The denoiser with its statistics, and the header of its file (``prbench.training.weights``)."""
        configuration = self.denoiser.configuration
        tensors = {f"denoiser.{name}": tensor for name, tensor in self.denoiser.state_dict().items()}
        tensors |= {"statistics.mean": self.mean, "statistics.std": self.std}
        if self.scaling is not None:
            tensors |= {"condition.mean": self.scaling.mean, "condition.std": self.scaling.std}
        metadata = {
            "kind": KIND,
            "configuration": msgspec.json.encode(configuration).decode(),
            "representation": representation_entry(configuration.representation),
        }
        return tensors, metadata

    def adapter(self, device: str) -> Adapter:
        """The method's own, with a copy of the weights as they are now."""
        network = copy.deepcopy(self.denoiser).to(device)
        return self.validating(
            MotionModel(network, mean=self.mean, std=self.std, scaling=self.scaling, texts=self.texts)
        )

    def learned_from(self) -> tuple[str, ...]:
        """The initial weights and the text encoder."""
        return self.origin
