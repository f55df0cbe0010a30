"""What a method gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped


@dataclass(frozen=True)
class Cost:
    """What the method itself declares about its effort; time and memory are measured by the harness."""

    network_passes: int


@dataclass(frozen=True)
class Motions:
    """Generated joint positions of a batch, in the canonical frame of each sequence's first frame, metres.

    Row i is valid up to ``n_frames[i]``; what stands behind is padding and is never looked at.
    """

    joints: Float[np.ndarray, "batch frames 22 3"]
    n_frames: Int[np.ndarray, " batch"]
    cost: Cost | None = None

    def ragged(self) -> Shaped[np.ndarray, "total 22 3"]:
        """The valid frames of all rows after one another."""
        valid = np.arange(self.joints.shape[1]) < self.n_frames[:, None]
        return self.joints[valid]
