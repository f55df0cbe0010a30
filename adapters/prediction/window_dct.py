"""A window of motion as a few coefficients of a discrete cosine transform over its frames.

Source: docs/specification/gazemodiff.md#network.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn


def dct_rows(coefficients: int, frames: int) -> Float[Tensor, "coefficients frames"]:
    """The first rows of the orthonormal DCT-II, float64: w_k cos(π(i + ½)k / frames)."""
    row = torch.arange(coefficients, dtype=torch.float64)[:, None]
    place = torch.arange(frames, dtype=torch.float64)[None] + 0.5
    rows = math.sqrt(2.0 / frames) * torch.cos(math.pi * place * row / frames)
    rows[0] = math.sqrt(1.0 / frames)
    return rows


def padded(
    observed: Float[Tensor, "windows observed nodes 3"],
    frames: int,
    gaze_valid: Bool[Tensor, "windows observed"] | None = None,
) -> Float[Tensor, "windows frames nodes 3"]:
    """The observation, followed by copies of its last frame.

    Args:
        observed: Joints in metres, and perhaps a direction as the last node.
        frames: Of the whole window.
        gaze_valid: Which directions were measured; each other one becomes the last measured one before it, at the
            start the first measured one. None if all were.

    Raises:
        ValueError: if a window has no measured direction, or is longer than ``frames``.
    """
    n = observed.shape[1]
    if n > frames:
        raise ValueError(f"an observation of {n} frames does not fit into a window of {frames}")
    if gaze_valid is not None:
        observed = held(observed, gaze_valid)
    return torch.cat([observed, observed[:, -1:].expand(-1, frames - n, -1, -1)], dim=1)


def held(
    observed: Float[Tensor, "windows observed nodes 3"], valid: Bool[Tensor, "windows observed"]
) -> Float[Tensor, "windows observed nodes 3"]:
    """Replace the last node where it was not measured by the last measured one before it, at the start by the first.

    Raises:
        ValueError: if a window has no measured direction.
    """
    if not bool(valid.any(dim=1).all()):
        window = int((~valid.any(dim=1)).nonzero()[0])
        raise ValueError(f"window {window} of the batch has no valid gaze in any observed frame")
    frame = torch.arange(valid.shape[1], device=valid.device)
    last = torch.where(valid, frame, -1).cummax(dim=1).values
    first = valid.to(torch.int8).argmax(dim=1, keepdim=True)
    source = torch.where(last < 0, first, last)
    rows = torch.arange(len(valid), device=valid.device)[:, None]
    gaze = observed[rows, source, -1]
    return torch.cat([observed[:, :, :-1], gaze[:, :, None]], dim=2)


class WindowDCT(nn.Module):
    """The transform of windows of one length, and the completion of a window by what was observed of it.

    Args:
        coefficients: How many are kept, L.
        observed: Frames that are known.
        frames: Of the whole window.
    """

    def __init__(self, coefficients: int, observed: int, frames: int) -> None:
        super().__init__()
        rows = dct_rows(coefficients, frames)
        self.register_buffer("rows", rows, persistent=False)
        # Back to frames, the observed ones only, and forth again: L by L numbers.
        self.register_buffer("observed_share", rows[:, :observed] @ rows[:, :observed].T, persistent=False)
        self.rows: Tensor
        self.observed_share: Tensor

    def forward(self, motion: Float[Tensor, "*batch frames nodes 3"]) -> Float[Tensor, "*batch coefficients values"]:
        """The first coefficients of each value; value = 3 · node + coordinate."""
        return self.rows.to(motion.dtype) @ motion.flatten(-2)

    def inverse(
        self, coefficients: Float[Tensor, "*batch coefficients values"]
    ) -> Float[Tensor, "*batch frames nodes 3"]:
        """The motion that these coefficients describe; not the original one, whose faster parts are lost."""
        return (self.rows.T.to(coefficients.dtype) @ coefficients).unflatten(-1, (-1, 3))

    def completed(
        self,
        coefficients: Float[Tensor, "*batch coefficients values"],
        known: Float[Tensor, "*#batch coefficients values"],
    ) -> Float[Tensor, "*batch coefficients values"]:
        """Coefficients of the motion whose observed frames are those of ``known``, and the others its own.

        The published programs go back to frames, exchange the observed ones, and transform again. All three are
        linear: x + (D_H D_Hᵀ)(known - x) with the columns D_H of the observed frames.
        """
        return coefficients + self.observed_share.to(coefficients.dtype) @ (known - coefficients)
