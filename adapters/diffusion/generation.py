"""From a batch of conditions to motions by plain sampling; the way of MDM, and of P&R without noise optimisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from prbench.contract import ConditionBatch, Cost, Motions
from prbench.errors import AdapterError
from prbench.skeleton import N_JOINTS
from prbench_adapters.diffusion.batching import parts_of_similar_length
from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.guidance import Precision, guided
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.noise import SequenceNoise
from prbench_adapters.diffusion.sampling import sample_ddim, sample_ddpm
from prbench_adapters.diffusion.skeletons import ModelBodies

_LARGEST_PART = {"cpu": 16}  # sequences in one pass; more do not run faster on a processor, but need more memory
_LARGEST_PART_ELSEWHERE = 256


@dataclass(frozen=True)
class SamplingSettings:
    """How motions are sampled."""

    guidance: float
    """Weight s of the text; 1 takes one network pass a step, anything else two."""
    sampler: Literal["ddpm", "ddim"] = "ddpm"
    steps: int | None = None
    """Of the training schedule; None for all of them."""
    precision: Precision = "float32"
    """``bfloat16`` takes two thirds of the time on processors that have it. Its rounding turns and shifts the path of a
    motion by some centimetres (poses by some millimetres), otherwise in another batch, so float32 is the default."""


def generate(model: MotionModel, batch: ConditionBatch, settings: SamplingSettings) -> Motions:
    """Sample one motion for each row, each from its own noise seed.

    Rows of similar length share a pass; which ones changes a motion by rounding only (less than 1e-4 m).

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    require_lengths(batch, model)
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


def require_lengths(batch: ConditionBatch, model: MotionModel) -> None:
    """Refuse sequences that a model cannot generate in full.

    Raises:
        AdapterError: with both lengths.
    """
    longest, most = int(batch.n_frames.max()), model.configuration.max_frames
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
    denoise = guided(
        model.denoiser, condition, torch.as_tensor(n_frames), settings.guidance, precision=settings.precision
    )
    start = noise.draw()
    if settings.sampler == "ddim":
        clean = sample_ddim(denoise, model.schedule, start, steps=settings.steps)
    else:
        clean = sample_ddpm(denoise, model.schedule, start, lambda _: noise.draw(), steps=settings.steps)
    return model.joints(clean).cpu().numpy(), denoise.passes
