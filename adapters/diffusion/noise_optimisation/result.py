"""What an optimisation gives back: motions, noise and the scalars of its course."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings

_TERMS = ("minimised", "initial", "goal", "jerk", "decorrelation", "gradient_norm")


@dataclass(frozen=True)
class History:
    """Scalars of every iteration; NaN where a sequence was finished. Iterates themselves are not kept.

    Row i is measured before the i-th step of the optimiser.
    """

    minimised: Float[np.ndarray, "iterations batch"]
    """The objective with its weighted terms, without decorrelation."""
    initial: Float[np.ndarray, "iterations batch"]
    goal: Float[np.ndarray, "iterations batch"]
    jerk: Float[np.ndarray, "iterations batch"]
    decorrelation: Float[np.ndarray, "iterations batch"]
    gradient_norm: Float[np.ndarray, "iterations batch"]
    """Length of the gradient of all terms before it is brought to 1."""
    learning_rate: Float[np.ndarray, " iterations"]

    @classmethod
    def empty(cls, iterations: int, batch: int) -> History:
        """A history of NaN."""
        return cls(
            **{name: np.full((iterations, batch), np.nan) for name in _TERMS},
            learning_rate=np.full(iterations, np.nan),
        )

    def put_rows(self, rows: np.ndarray, other: History) -> None:
        """Take the columns of another history of as many iterations."""
        for name in _TERMS:
            getattr(self, name)[:, rows] = getattr(other, name)
        done = ~np.isnan(other.learning_rate)
        self.learning_rate[done] = other.learning_rate[done]


@dataclass(frozen=True)
class OptimisedMotions:
    """Optimised motions of B sequences, in the order in which they were given."""

    joints: Float[torch.Tensor, "batch frames 22 3"]
    """Canonical frame, metres; decoded from ``noise`` by as many steps as it was optimised with."""
    noise: Float[torch.Tensor, "batch frames features"]
    n_frames: Int[torch.Tensor, " batch"]
    initial: Float[torch.Tensor, " batch"]
    """L_init of ``joints``, m²."""
    goal: Float[torch.Tensor, " batch"]
    """L_goal of ``joints``, m²."""
    jerk: Float[torch.Tensor, " batch"]
    """L_jerk of ``joints``, metres per frame³."""
    network_passes: Int[torch.Tensor, " batch"]
    """Forward passes of the denoiser spent on each sequence, guidance and recomputed ones included."""
    iterations: Int[torch.Tensor, " batch"]
    history: History
    settings: OptimisationSettings
