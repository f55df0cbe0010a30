"""What training minimises (docs/specification/wandr.md#training)."""

from __future__ import annotations

from typing import Literal

import msgspec
import torch
from jaxtyping import Float

from prbench_adapters.wandr.state import JOINTS, ROOT, TRANSLATION

_CENTIMETRES = 100.0


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The losses, and the training on the network's own output; the defaults are those of the original."""

    kl_weight: float = 1e-2
    free_bits: float = 0.05
    """Below this, the divergence of a dimension is not pushed down any further."""
    joint_loss_weight: float = 1.0
    """Of the squared error of the joints, square centimetres."""
    longest_chunk: int = 10
    """Frames that the network runs on its own output at most."""
    steps_per_chunk_frame: int = 1000
    """Training steps after which chunks may be one frame longer (the original: five epochs)."""
    own_latents: Literal["encoded", "drawn"] = "encoded"
    """Where the latents of chunks come from: the encoder, which sees the change that is wanted, as in the original, or
    the standard normal distribution, as in generation. What corrects a body that has strayed may come from the encoder
    in the first case; generation has none. In the second it must come from state and goal."""
    frames_per_step: int = 0
    """Of all frames in a batch so many are drawn for a step, and as many for the network's own output; 0 takes all."""

    def __post_init__(self) -> None:
        for name in ("kl_weight", "free_bits", "joint_loss_weight", "frames_per_step"):
            if getattr(self, name) < 0:
                raise ValueError(f"'{name}' must be at least 0, found {getattr(self, name)}")
        for name in ("longest_chunk", "steps_per_chunk_frame"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")


def delta_loss(
    decoded: Float[torch.Tensor, "places 135"], wanted: Float[torch.Tensor, "places 135"]
) -> Float[torch.Tensor, ""]:
    """Mean squared errors of standardised changes: translation, root and joints each for themselves, summed."""
    error = (decoded - wanted).square()
    return sum((error[:, part].mean() for part in (TRANSLATION, ROOT, JOINTS)), error.new_zeros(()))


def joint_loss(
    predicted: Float[torch.Tensor, "places 22 3"], recorded: Float[torch.Tensor, "places 22 3"]
) -> Float[torch.Tensor, ""]:
    """Mean squared error of coordinates, square centimetres."""
    return ((predicted - recorded) * _CENTIMETRES).square().mean()


def divergence(
    mean: Float[torch.Tensor, "places latent"], log_variance: Float[torch.Tensor, "places latent"], free_bits: float
) -> Float[torch.Tensor, ""]:
    """Mean over dimensions of the divergence from a standard normal distribution, each at least ``free_bits``."""
    each = 0.5 * (mean.square() + log_variance.exp() - log_variance - 1)
    return each.clamp_min(free_bits).mean()
