"""How much joints tremble, and the motion beneath the trembling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_TREMBLING, _TREMOR = 1.2, 0.003  # second over first differences (noise 1.7, movement 0.3); metres
SMOOTHED_OVER = 1.5
"""Standard deviation of the Gaussian in :func:`smoothed`, frames."""


@dataclass(frozen=True)
class Tremor:
    """Trembling of most motions; medians over them."""

    ratio: float
    """Second over first differences of the joints relative to the pelvis."""
    metres: float
    motions: int
    """How many were long enough to look at."""

    @classmethod
    def of(cls, motions: Sequence[Float[np.ndarray, "_frames 22 3"]]) -> Tremor | None:
        """Measure motions; None if they do not tremble, or are too short to tell."""
        ratios, sizes = [], []
        for motion in motions:
            if len(motion) <= 4:
                continue
            limbs = motion - motion[:, :1]
            first, second = (np.linalg.norm(np.diff(limbs, n, axis=0), axis=-1).mean(axis=-1) for n in (1, 2))
            ratios.append(float(np.median(second) / max(float(np.median(first)), 1e-9)))
            sizes.append(float(np.median(second)) / np.sqrt(6))
        if not ratios or np.median(ratios) < _TREMBLING or np.median(sizes) < _TREMOR:
            return None
        return cls(float(np.median(ratios)), float(np.median(sizes)), len(ratios))


def smoothed(motion: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """The motion without what changes from frame to frame."""
    from scipy.ndimage import gaussian_filter1d  # late: 0.3 s that a run and its workers do not need

    return gaussian_filter1d(motion, SMOOTHED_OVER, axis=0, mode="nearest")
