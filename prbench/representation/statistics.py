"""Mean and standard deviation of features, as HumanML3D has them (docs/specification/humanml3d.md#normalisation)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.errors import UsageError
from prbench.representation.features import (
    BLOCKS,
    FOOT_CONTACTS,
    N_FEATURES,
    ROOT_HEIGHT,
    ROOT_LINEAR_VELOCITY,
    ROOT_YAW_VELOCITY,
)

_CONSTANT = 1e-8  # a block that varies less is left unscaled
_EVALUATOR_WEIGHT = 25.0
_WEIGHTED = (ROOT_YAW_VELOCITY, ROOT_LINEAR_VELOCITY, ROOT_HEIGHT, FOOT_CONTACTS)


@dataclass(frozen=True)
class Statistics:
    """Mean and deviation that features are standardised with; kept beside the weights that learnt from them."""

    mean: Float[np.ndarray, " 263"]
    """Mean of each feature, float32."""
    std: Float[np.ndarray, " 263"]
    """One number a block: the average of the standard deviations in it, float32."""

    def standardise(self, features: Float[np.ndarray, "*batch 263"]) -> Float[np.ndarray, "*batch 263"]:
        """``(features - mean) / std``."""
        return (features - self.mean) / self.std

    def restore(self, standardised: Float[np.ndarray, "*batch 263"]) -> Float[np.ndarray, "*batch 263"]:
        """The inverse of :meth:`standardise`."""
        return standardised * self.std + self.mean

    def for_evaluator(self) -> Statistics:
        """Weight root and contacts up as text-to-motion evaluators do.

        Their standard deviation is divided by 25, the measured ratio of the published ones.
        """
        std = self.std.copy()
        for block in _WEIGHTED:
            std[block] /= _EVALUATOR_WEIGHT
        return Statistics(self.mean, std)


class StatisticsAccumulator:
    """Statistics of a corpus that does not fit into memory, motion by motion.

    The result depends on the features only, up to rounding in float64, not on how they were portioned.

    >>> accumulator = StatisticsAccumulator()
    >>> accumulator.add(np.zeros((4, 263), dtype=np.float32))
    True
    >>> float(accumulator.result().std[0])  # constant features stay as they are
    1.0
    """

    def __init__(self) -> None:
        self._count = 0
        self._mean = np.zeros(N_FEATURES)
        self._squares = np.zeros(N_FEATURES)  # sum of squared distances from the mean
        self.skipped = 0
        """Motions that were left out because they hold NaN."""

    @property
    def count(self) -> int:
        """Rows so far."""
        return self._count

    def add(self, features: Float[np.ndarray, "rows 263"]) -> bool:
        """Add the raw features of a motion; one that holds NaN is left out, as in the original.

        Returns:
            Whether it was added.
        """
        if not len(features):
            return False
        if not np.isfinite(features).all():
            self.skipped += 1
            return False
        rows = features.astype(np.float64)
        mean = rows.mean(axis=0)
        squares = ((rows - mean) ** 2).sum(axis=0)
        self._merge(len(rows), mean, squares)
        return True

    def result(self) -> Statistics:
        """Mean of each feature and standard deviation of each block; a constant block gets 1.

        Raises:
            UsageError: if nothing was added.
        """
        if not self._count:
            raise UsageError(
                f"statistics: expected motions to take them from, found none ({self.skipped} left out for NaN)."
            )
        each = np.sqrt(self._squares / self._count)
        std = np.empty(N_FEATURES)
        for block in BLOCKS.values():
            std[block] = each[block].mean()
        std[std < _CONSTANT] = 1.0
        return Statistics(self._mean.astype(np.float32), std.astype(np.float32))

    def _merge(self, count: int, mean: np.ndarray, squares: np.ndarray) -> None:
        """Join two portions by their counts, means and squares (Chan, Golub and LeVeque, 1983)."""
        total = self._count + count
        apart = mean - self._mean
        self._mean = self._mean + apart * (count / total)
        self._squares = self._squares + squares + apart**2 * (self._count * count / total)
        self._count = total
