"""Losses of primitives, and the phases of their training (docs/specification/dart.md#training)."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from prbench_adapters.dart.configuration import HISTORY_FRAMES
from prbench_adapters.dart.frames import Frames
from prbench_adapters.kinematics import forward_kinematics

_PerMotion = Float[Tensor, " batch"]
Shares = tuple[float, float, float]
PARTS = ("reconstruction", "divergence", "body", "consistency", "deltas", "latent")
"""Names of the parts of the loss; those that a phase does not have are 0 in its log."""


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Weights of the losses, and how the training is divided; the defaults are the original's.

    Raises:
        ValueError: for shares that divide nothing.
    """

    vae_share: float = 0.4
    """Share of the VAE's phase in the training, after which it is frozen and the denoiser trained. 0 keeps the VAE of
    the initial weights."""
    vae_stages: Shares = (0.5, 0.25, 0.25)
    """Shares of the phase in which primitives start from recorded history, ever more often from the end of what was
    just predicted, and always from that."""
    denoiser_stages: Shares = (1 / 3, 1 / 3, 1 / 3)
    primitives: int = 4
    """Consecutive ones of each training motion."""
    windows: int = 1
    """Number of times that they are drawn from each motion of a batch."""
    vae_batch_size: int | None = None
    """Motions of each batch that the VAE's phase looks at; None for all."""
    kl_weight: float = 1e-6
    joint_weight: float = 10.0
    """Weight of joints that follow from predicted rotations, against the recorded."""
    consistency_weight: float = 10.0
    """Weight of predicted joints against those that follow from predicted rotations."""
    vae_delta_weight: float = 100.0
    """Weight of predicted deltas against differences of predictions: translation, orientation and joints each."""
    latent_weight: float = 1.0
    denoiser_delta_weight: float = 1e4
    text_drop: float = 0.1
    """Share of motions whose text is hidden, so that guidance has an unconditional model."""

    def __post_init__(self) -> None:
        if not 0 <= self.vae_share < 1:
            raise ValueError(f"'vae_share' must be at least 0 and below 1, found {self.vae_share}")
        for name in ("vae_stages", "denoiser_stages"):
            shares = getattr(self, name)
            if min(shares) < 0 or abs(sum(shares) - 1) > 1e-6:
                raise ValueError(f"'{name}' must be three shares that sum to 1, found {shares}")
        if self.primitives < 1 or self.windows < 1 or (self.vae_batch_size is not None and self.vae_batch_size < 1):
            raise ValueError("'primitives', 'windows' and 'vae_batch_size' must be at least 1")
        if not 0 <= self.text_drop <= 1:
            raise ValueError(f"'text_drop' must be between 0 and 1, found {self.text_drop}")


def huber(predicted: Float[Tensor, "batch *values"], wanted: Float[Tensor, "batch *values"]) -> _PerMotion:
    """Huber's loss with δ = 1, mean over each motion's values."""
    return functional.huber_loss(predicted, wanted, reduction="none").flatten(1).mean(dim=1)


def divergence(mean: Float[Tensor, "batch 1 latent"], log_variance: Float[Tensor, "batch 1 latent"]) -> _PerMotion:
    """Divergence from the standard normal distribution, mean over dimensions."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).flatten(1).mean(dim=1)


def body_losses(
    predicted: Frames, recorded: Frames, offsets: Float[Tensor, "batch 22 3"]
) -> tuple[_PerMotion, _PerMotion]:
    """Compare the joints that follow from predicted rotations with the recorded and with the predicted joints.

    Args:
        predicted: Future frames.
        recorded: The same in the recording.
        offsets: Bones of each motion (:func:`prbench_adapters.kinematics.rest_offsets`).
    """
    moved = forward_kinematics(predicted.rotations(), predicted.translation, offsets[:, None])
    return huber(moved, recorded.joints), huber(predicted.joints, moved)


def delta_loss(predicted: Frames, history: Frames) -> _PerMotion:
    """Compare deltas with the differences that they announce, from the last frame of the history on; sum of three.

    Args:
        predicted: Future frames.
        history: The frames before them, in the same frame of reference.
    """
    # The last frame of the history announces the step to the first predicted frame.
    before = history.part(HISTORY_FRAMES - 1, HISTORY_FRAMES)

    def chain(name: str) -> Tensor:
        return torch.cat((getattr(before, name), getattr(predicted, name)), dim=1)

    orientation = chain("orientation")
    return (
        huber(chain("translation_delta")[:, :-1], chain("translation").diff(dim=1))
        + huber(chain("orientation_delta")[:, :-1], orientation[:, 1:] @ orientation[:, :-1].mT)
        + huber(chain("joints_delta")[:, :-1], chain("joints").diff(dim=1))
    )


class Totals:
    """Losses of all primitives of a step, averaged over those that lie inside their motion.

    Args:
        valid: Which do.
    """

    def __init__(self, valid: Bool[Tensor, "batch primitives"]) -> None:
        self.valid, self.sums = valid, dict[str, Tensor]()

    def add(self, number: int, losses: dict[str, _PerMotion]) -> None:
        """The losses of one primitive of each motion."""
        for name, loss in losses.items():
            kept = torch.where(self.valid[:, number], loss, 0.0).sum()
            self.sums[name] = self.sums.get(name, 0.0) + kept

    def result(self, **weights: float) -> dict[str, Tensor]:
        """The weighted sum ``loss`` and all parts."""
        # Over all primitives together, so that each one inside its motion weighs the same.
        count = self.valid.sum().clamp_min(1)
        parts = {name: total / count for name, total in self.sums.items()}
        loss = torch.stack([weights[name] * part for name, part in parts.items()]).sum()
        return {"loss": loss, **{name: parts.get(name, torch.zeros_like(loss)).detach() for name in PARTS}}


@dataclass(frozen=True)
class Moment:
    """Phase and progress of a training at one call."""

    vae: bool
    """True while the VAE is trained, False while the denoiser is."""
    progress: float
    """Share of the phase that is over, from 0 to 1."""
    feedback: float
    """Probability that a primitive starts from the end of what was predicted before it."""


def moment_of(step: int, calls: int, objective: Objective) -> Moment:
    """Return the phase and progress of a training at one call.

    Args:
        step: Counts the calls of the whole training from 0.
        calls: How many there are.
        objective: Shares of the phases, and of their stages.
    """
    # Counted in calls, so that a resumed training is in the same phase.
    of_vae = round(objective.vae_share * calls)
    if step < of_vae:
        progress = step / of_vae
        return Moment(True, progress, feedback(progress, objective.vae_stages))
    progress = min(1.0, (step - of_vae) / max(1, calls - of_vae))
    return Moment(False, progress, feedback(progress, objective.denoiser_stages))


def feedback(progress: float, stages: Shares) -> float:
    """Probability of starting from one's own prediction: 0 in the first stage, 1 in the last, rising in between."""
    recorded, rising, _ = stages
    if progress < recorded:
        return 0.0
    return min(1.0, (progress - recorded) / rising) if rising else 1.0
