"""Plain sampling of motions for a batch of conditions: the way of MDM, and of P&R without noise optimisation.

Classifier-free guidance takes the conditional and the unconditional estimate from one pass of twice the batch.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prbench.contract import ConditionBatch, Cost, Motions
from prbench.errors import AdapterError
from prbench.geometry.skeleton import N_JOINTS
from prbench_adapters.diffusion.batches import ModelBodies, SequenceNoise, parts_of_similar_length
from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser, frame_mask
from prbench_adapters.diffusion.frame_denoiser import FrameDenoiser
from prbench_adapters.diffusion.model import Feet, MotionModel, Reach
from prbench_adapters.diffusion.sampling import sample_ddim, sample_ddpm

Precision = Literal["float32", "bfloat16"]
"""The first also stands for float64, if that is what the network is made of."""
_LARGEST_PART = {"cpu": 16}  # sequences in one pass; more do not run faster on a processor, but need more memory
_LARGEST_PART_ELSEWHERE = 256


class Guidance:
    """Classifier-free guidance of one pass of twice the batch, and how many passes a sampler took.

    x0 = x0_unconditional + scale · (x0_conditional - x0_unconditional). Scale 1 is the conditional estimate alone, in
    one pass of the plain batch.

    Args:
        scale: Guidance weight s.
    """

    def __init__(self, scale: float) -> None:
        self.scale = scale
        self.doubled = scale != 1.0
        self.passes = 0
        """Network passes so far, summed over sequences; guidance takes two a sequence, backward passes are none."""

    def both(self, conditional: Tensor, unconditional: Tensor) -> Tensor:
        """The rows of a pass: the conditional ones, and with guidance the unconditional ones behind them."""
        return torch.cat((conditional, unconditional)) if self.doubled else conditional

    def estimate(self, predict: Callable[[Tensor], Tensor], noisy: Tensor) -> Tensor:
        """The guided estimate; ``predict`` gets the noisy rows of :meth:`both` halves."""
        rows = self.both(noisy, noisy)
        self.passes += len(rows)
        predicted = predict(rows)
        if not self.doubled:
            return predicted
        conditional, unconditional = predicted.chunk(2)
        # Extrapolation for scales above 1: lerp is u + s (c - u).
        return torch.lerp(unconditional, conditional, self.scale)


class Guided(Guidance):
    """A denoiser under a condition, as the samplers call it, step by step.

    The unconditional half has zeros for the text vectors and the same condition vector.

    Args:
        denoiser: In evaluation mode.
        condition: B rows.
        n_frames: Valid frames of each row.
        scale: Guidance weight s.
        reuse: Keep what is computed from condition and step for the next chain: for noise optimisation, which walks
            the same steps hundreds of times with frozen weights. The results are the same.
        precision: Of the matrix products inside the network; what goes in and comes out stays as it is.
    """

    def __init__(
        self,
        denoiser: Denoiser | FrameDenoiser,
        condition: EncodedCondition,
        n_frames: Int[Tensor, " batch"],
        scale: float,
        *,
        reuse: bool = False,
        precision: Precision = "float32",
    ) -> None:
        super().__init__(scale)
        self.denoiser, self.precision = denoiser, precision
        self.condition = condition.then(condition.without_text()) if self.doubled else condition
        # On the CPU a batch without padding is recognised without waiting for the device, and then needs no mask.
        host = n_frames.cpu()
        self._n_frames = self.both(host, host)
        self._prepared: dict[int, Any] | None = {} if reuse else None
        self._masks: dict[int, Tensor | None] = {}

    def __call__(
        self, noisy: Float[Tensor, "batch frames features"], step: int
    ) -> Float[Tensor, "batch frames features"]:
        """The guided estimate of the clean features at ``step`` of the training schedule."""

        def predict(rows: Tensor) -> Tensor:
            with self._computing(noisy.device):
                clean = self.denoiser.denoise(rows, self.prepared(step), self._visible(rows))
            return clean.to(noisy.dtype)

        return self.estimate(predict, noisy)

    def prepared(self, step: int) -> Any:
        """Keys and values of the condition at ``step``: computed anew, or once only with ``reuse``."""
        if self._prepared is None:
            return self._prepare(step)
        if step not in self._prepared:
            self._prepared[step] = self._prepare(step)
        return self._prepared[step]

    def _prepare(self, step: int) -> Any:
        where = self.condition.text.device
        return self.denoiser.prepare(self.condition, torch.full((1,), step, dtype=torch.long, device=where))

    def _computing(self, device: torch.device) -> AbstractContextManager[object]:
        if self.precision == "float32":
            return nullcontext()
        return torch.autocast(device.type, dtype=torch.bfloat16)

    def _visible(self, noisy: Tensor) -> Tensor | None:
        frames = noisy.shape[1]
        if frames not in self._masks:
            self._masks[frames] = frame_mask(self._n_frames, frames, noisy.device)
        return self._masks[frames]


@dataclass(frozen=True)
class SamplingSettings:
    """Settings of plain sampling."""

    guidance: float
    """Weight s of the text; 1 takes one network pass a step, anything else two."""
    sampler: Literal["ddpm", "ddim"] = "ddpm"
    steps: int | None = None
    """Steps of the training schedule that are taken; None for all of them."""
    precision: Precision = "float32"
    """``bfloat16`` takes two thirds of the time on processors that have it. Its rounding turns and shifts the path of a
    motion by some centimetres (poses by some millimetres), otherwise in another batch, so float32 is the default."""
    reach: Reach = "predicted"
    """``goal`` leads the nearer wrist to a goal location within the last half second, in closed form."""
    feet: Feet = "steps"
    """``steps`` lets the feet of goal-frame features stand or swing; ``predicted`` leaves them as they are."""
    noise_scale: float = 1.0
    """Standard deviation of the noise that sampling starts from. Above the 1 of training, several motions of one
    sequence differ more; 0 gives the one motion of no noise."""


def generate(model: MotionModel, batch: ConditionBatch, settings: SamplingSettings) -> Motions:
    """Sample one motion for each row, each from its own noise seed.

    Rows of similar length share a pass; which ones changes a motion by rounding only (less than 1e-4 m).

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    require_lengths(batch, model.configuration.max_frames)
    bodies = ModelBodies.of(batch, model.configuration)
    condition = model.encode(bodies.batch)
    joints = np.zeros((len(batch), int(batch.n_frames.max()), N_JOINTS, 3), dtype=np.float32)
    passes = 0
    largest = _LARGEST_PART.get(model.device.type, _LARGEST_PART_ELSEWHERE)
    for rows in parts_of_similar_length(batch.n_frames, largest):
        n_frames = batch.n_frames[rows]
        noise = SequenceNoise([batch.noise_seed[row] for row in rows], n_frames, model.device)
        own, spent = _sample(model, condition.rows(rows.tolist()), n_frames, noise, settings)
        joints[rows, : own.shape[1]] = own
        passes += spent
    return Motions(bodies.own(joints), batch.n_frames, Cost(passes))


def require_lengths(batch: ConditionBatch, most: int) -> None:
    """Refuse sequences of more than ``most`` frames, which a model cannot generate in full.

    Raises:
        AdapterError: with both lengths.
    """
    longest = int(batch.n_frames.max())
    if longest > most:
        raise AdapterError(f"the model generates at most {most} frames, and was asked for {longest}.")


@torch.no_grad()
def _sample(
    model: MotionModel,
    condition: EncodedCondition,
    n_frames: np.ndarray,
    noise: SequenceNoise,
    settings: SamplingSettings,
) -> tuple[np.ndarray, int]:
    """Joints (rows, frames, 22, 3) and the network passes that they took."""
    denoise = Guided(
        model.denoiser, condition, torch.as_tensor(n_frames), settings.guidance, precision=settings.precision
    )
    columns = model.configuration.n_features
    start = settings.noise_scale * noise.draw(columns)
    if settings.sampler == "ddim":
        clean = sample_ddim(denoise, model.schedule, start, steps=settings.steps)
    else:
        clean = sample_ddpm(denoise, model.schedule, start, lambda _: noise.draw(columns), steps=settings.steps)
    lengths = torch.as_tensor(n_frames)
    joints = model.joints(clean, condition, lengths, reach=settings.reach, feet=settings.feet)
    return joints.cpu().numpy(), denoise.passes
