"""What training minimises: squared errors of features and of joints over the valid frames.

docs/specification/pr-model.md#training (*Prime and Reach*, section 4.2: L + L_joint). Both sums are divided by
263 x valid frames, which keeps the study's ratio between them and MDM's scale.
"""

from __future__ import annotations

from typing import Literal

import msgspec
import torch
from jaxtyping import Bool, Float

from prbench.representation.features import N_FEATURES
from prbench.skeleton import BONES

_PARENTS, _CHILDREN = (list(ends) for ends in zip(*BONES, strict=True))


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The losses, which diffusion steps are trained, and how often the text is hidden."""

    joint_loss_weight: float = 1.0
    """Of L_joint in square metres; 0 trains on features alone (table S5)."""
    velocity_loss_weight: float = 0.0
    """Of the squared error of joint displacements between neighbouring frames, square metres; not in the study."""
    bone_loss_weight: float = 0.0
    """Of the squared error of the 21 bone vectors, square metres; not in the study. It teaches small models to keep
    lengths, and where the head points."""
    noisiest_share: float = 0.0
    """Share of the sequences that are trained on the noisiest sixth of the diffusion steps, beyond the uniform draw of
    the study. There alone the condition decides where a motion goes: afterwards the noisy motion shows it already."""
    text_drop: float = 0.2
    """Share of sequences whose text is replaced by the null text (*Prime and Reach*, section 5.1)."""
    loss_average: Literal["frames", "sequences"] = "frames"
    """Whether a batch is averaged over its frames (P&R) or over its sequences.

    Source: docs/specification/mdm.md#training.
    """


def losses(
    objective: Objective,
    predicted: Float[torch.Tensor, "batch frames features"],
    clean: Float[torch.Tensor, "batch frames features"],
    predicted_joints: Float[torch.Tensor, "batch frames 22 3"],
    joints: Float[torch.Tensor, "batch frames 22 3"],
    padding: Bool[torch.Tensor, "batch frames"],
) -> dict[str, torch.Tensor]:
    """The weighted sum ``loss`` and its parts ``features``, ``joints``, ``velocities`` and ``bones``, unweighted.

    Args:
        objective: The weights.
        predicted: The network's clean features, standardised.
        clean: The recorded ones.
        predicted_joints: Decoded from the prediction, metres.
        joints: The recorded ones, same frame.
        padding: True where there is no frame; whatever stands there leaves no trace.
    """
    valid = ~padding
    error = predicted_joints - joints
    parts = {
        "features": _average(objective, _squared(predicted - clean, valid), valid),
        "joints": _average(objective, _squared(error, valid), valid),
        "velocities": _average(objective, _squared(error.diff(dim=1), valid[:, 1:]), valid),
        "bones": _average(objective, _squared(error[:, :, _CHILDREN] - error[:, :, _PARENTS], valid), valid),
    }
    total = (
        parts["features"]
        + objective.joint_loss_weight * parts["joints"]
        + objective.velocity_loss_weight * parts["velocities"]
        + objective.bone_loss_weight * parts["bones"]
    )
    return {"loss": total, **{name: part.detach() for name, part in parts.items()}}


def _squared(
    error: Float[torch.Tensor, "batch frames *value"], valid: Bool[torch.Tensor, "batch frames"]
) -> Float[torch.Tensor, " batch"]:
    """Sum of the squares of each sequence over its valid frames."""
    per_frame = error.square().flatten(2).sum(dim=2)
    return torch.where(valid, per_frame, 0.0).sum(dim=1)


def _average(
    objective: Objective, summed: Float[torch.Tensor, " batch"], valid: Bool[torch.Tensor, "batch frames"]
) -> Float[torch.Tensor, ""]:
    frames = valid.sum(dim=1)
    if objective.loss_average == "sequences":
        return (summed / (N_FEATURES * frames)).mean()
    return summed.sum() / (N_FEATURES * frames.sum())
