"""Percentiles of the bootstrap over recordings, computed instead of drawn.

A replicate draws as many recordings as there are, with replacement, and takes the mean over their sequences. Its
distribution follows from its characteristic function (Gil-Pelaez 1951, with the midpoint sum of Davies 1973), which is
that of one draw to the power of the number of draws. So there are no replicates whose number or seed could move a
printed digit: the result is that of infinitely many, it depends on nothing but the values, and values that differ by
little give percentiles that differ as little.

The distribution of few recordings has steps. They are rounded off by a normal kernel a tenth as wide as the
distribution (narrower where one recording alone makes it wide), and the draws move together by as much, so that its
variance stays what it is (Silverman and Young 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np
from jaxtyping import Float, Int
from scipy import optimize, special

_WIDEST_KERNEL = 0.1  # standard deviation of the kernel, as a part of that of the distribution
_NARROWEST_KERNEL = 0.02
_LAST_FREQUENCY = 6.0  # times the inverse of the kernel's width, where its own function has fallen to 1.5e-8
_CERTAIN = 8.0  # standard deviations from the mean beyond which a probability is 0 or 1
_PERIOD = 40.0  # of the midpoint sum, in standard deviations: the sum is right where |total| is below half of it
_BLOCK = 128  # frequencies at a time; most distributions need one block or two
_NEGLIGIBLE = 1e-8
_ACCURACY = 1e-6  # of a percentile, in standard errors


@dataclass(frozen=True, eq=False)
class RecordingTotals:
    """The recordings that a replicate draws from."""

    totals: Float[np.ndarray, " recordings"]
    """Sum over the sequences of each recording."""
    sizes: Int[np.ndarray, " recordings"]
    """Number of sequences of each recording."""
    inner_variance: Float[np.ndarray, " recordings"]
    """Variance of each total if the samples of its sequences are drawn anew; 0 with one sample a sequence."""

    def percentile(self, probability: float, *, lowest: float, highest: float) -> float:
        """The mean over sequences that a replicate stays below with this probability.

        Args:
            probability: From 0 to 1, not including them.
            lowest: Smallest value of the data, which no mean falls below.
            highest: Largest value, which no mean exceeds.
        """
        mean = float(self.totals.sum() / self.sizes.sum())
        error = self._spread(self.totals - mean * self.sizes) / float(self.sizes.sum())
        if error == 0:
            return mean
        guess = mean + error * float(special.ndtri(probability))  # of a normal distribution: rarely far away

        @cache
        def missing(bound: float) -> float:
            return self.probability_below(bound) - probability

        # A bracket around the normal guess first: each evaluation costs a sum over all frequencies.
        for low, high in ((max(guess - error, lowest), min(guess + error, highest)), (lowest, highest)):
            if missing(low) < 0 < missing(high):
                return cast(float, optimize.brentq(missing, low, high, xtol=_ACCURACY * error))
        return lowest if missing(lowest) >= 0 else highest

    def probability_below(self, mean: float) -> float:
        """Probability that the mean of a replicate is below a number: that its total minus the number's share is."""
        excess = self.totals - mean * self.sizes
        count = len(excess)
        centre = count * excess.mean()
        spread = self._spread(excess)
        if abs(centre) > _CERTAIN * spread:
            return float(centre < 0)
        if spread == 0:
            return 0.5
        kernel = _kernel_width(excess - excess.mean())
        steps = (excess - excess.mean()) / spread
        variance = self.inner_variance / spread**2
        summed = _midpoint_sum(steps, variance, kernel=kernel, centre=float(centre / spread))
        return float(np.clip(0.5 - summed / np.pi, 0.0, 1.0))

    def _spread(self, excess: Float[np.ndarray, " recordings"]) -> float:
        """Standard deviation of the sum of the draws."""
        return float(np.sqrt(len(excess) * (excess.var() + self.inner_variance.mean())))


def _kernel_width(deviations: Float[np.ndarray, " recordings"]) -> float:
    """Width of the kernel as a part of the spread: less where the spread is that of a single recording."""
    count = len(deviations)
    squares = deviations**2
    without_farthest = squares.sum() - squares.max() * count / (count - 1)  # about the mean of the others
    kept = np.sqrt(max(without_farthest, 0.0) / squares.sum()) if squares.any() else 1.0
    return float(np.clip(_WIDEST_KERNEL * kept, _NARROWEST_KERNEL, _WIDEST_KERNEL))


def _midpoint_sum(
    steps: Float[np.ndarray, " recordings"],
    variance: Float[np.ndarray, " recordings"],
    *,
    kernel: float,
    centre: float,
) -> float:
    """The sum of Gil-Pelaez for a total with standard deviation 1, up to frequencies that no longer count."""
    count = len(steps)
    shrinking = 1 - kernel**2
    inner_spread = bool(variance.any())
    total = 0.0
    for first in range(0, int(_LAST_FREQUENCY / kernel * _PERIOD / (2 * np.pi)), _BLOCK):
        number = np.arange(first, first + _BLOCK) + 0.5
        frequency = 2 * np.pi / _PERIOD * number
        turns = 1j * np.outer(np.sqrt(shrinking) * steps, frequency)
        if inner_spread:
            turns -= np.outer(shrinking * variance, frequency**2) / 2
        one_draw = np.exp(turns).mean(axis=0)
        function = one_draw**count * np.exp(1j * centre * frequency - (kernel * frequency) ** 2 / 2)
        total += float((function.imag / number).sum())
        if np.abs(function).max() < _NEGLIGIBLE:
            break
    return total
