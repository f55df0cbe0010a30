"""Where a training of DART is: in the VAE's phase or the denoiser's, and how often it starts from what it predicted."""

from __future__ import annotations

from dataclasses import dataclass

from prbench_adapters.dart.losses import Objective, Shares


@dataclass(frozen=True)
class Moment:
    """Where in its training a call is."""

    vae: bool
    """Whether the VAE is trained, or the denoiser."""
    progress: float
    """Share of the phase that is over, from 0 to 1."""
    feedback: float
    """Probability that a primitive starts from the end of what was predicted before it."""


def moment_of(step: int, calls: int, objective: Objective) -> Moment:
    """Where a call of the training is.

    Args:
        step: Counts the calls of the whole training from 0.
        calls: How many there are.
        objective: Shares of the phases, and of their stages.
    """
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
