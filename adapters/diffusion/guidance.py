"""Classifier-free guidance: the conditional and the unconditional estimate from one pass of twice the batch."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser, PreparedCondition, frame_mask

Precision = Literal["float32", "bfloat16"]
"""The first also stands for float64, if that is what the network is made of."""


class Guided:
    """A denoiser with its condition: what a sampler calls, step by step. Made by :func:`guided`."""

    def __init__(
        self,
        denoiser: Denoiser,
        condition: EncodedCondition,
        n_frames: Int[Tensor, " batch"],
        scale: float,
        *,
        reuse: bool,
        precision: Precision,
    ) -> None:
        self.denoiser, self.scale, self.precision = denoiser, scale, precision
        self.doubled = scale != 1.0
        self.condition = condition.then(condition.without_text()) if self.doubled else condition
        host = n_frames.cpu()
        self._n_frames = torch.cat([host, host]) if self.doubled else host
        self._prepared: dict[int, PreparedCondition] | None = {} if reuse else None
        self._masks: dict[int, Tensor | None] = {}
        self.passes = 0
        """Network passes so far, summed over sequences; guidance takes two a sequence."""

    def __call__(self, noisy: Float[Tensor, "batch frames 263"], step: int) -> Float[Tensor, "batch frames 263"]:
        """The guided estimate of the clean features at ``step`` of the training schedule."""
        doubled = torch.cat([noisy, noisy]) if self.doubled else noisy
        self.passes += len(doubled)
        with self._computing(noisy.device):
            clean = self.denoiser.denoise(doubled, self.prepared(step), self._visible(doubled))
        clean = clean.to(noisy.dtype)
        if not self.doubled:
            return clean
        conditional, unconditional = clean.chunk(2)
        return torch.lerp(unconditional, conditional, self.scale)

    def prepared(self, step: int) -> PreparedCondition:
        """Keys and values of the condition at ``step``: computed anew, or once only with ``reuse``."""
        if self._prepared is None:
            return self._prepare(step)
        if step not in self._prepared:
            self._prepared[step] = self._prepare(step)
        return self._prepared[step]

    def _prepare(self, step: int) -> PreparedCondition:
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


def guided(
    denoiser: Denoiser,
    condition: EncodedCondition,
    n_frames: Int[Tensor, " batch"],
    scale: float,
    *,
    reuse: bool = False,
    precision: Precision = "float32",
) -> Guided:
    """The denoiser under ``condition`` as the samplers take it.

    x0 = x0_unconditional + scale · (x0_conditional - x0_unconditional). The unconditional half has zeros for the text
    vectors and the same condition vector. Scale 1 is the conditional estimate alone, in one pass of the plain batch.

    Args:
        denoiser: In evaluation mode.
        condition: B rows.
        n_frames: Valid frames of each row.
        scale: Guidance weight s.
        reuse: Keep what is computed from condition and step for the next chain: for noise optimisation, which walks
            the same steps hundreds of times with frozen weights. The results are the same.
        precision: Of the matrix products inside the network; what goes in and comes out stays as it is.
    """
    return Guided(denoiser, condition, n_frames, scale, reuse=reuse, precision=precision)
