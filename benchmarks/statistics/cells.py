"""What one cell of the grid measures: coverage and width of intervals, false positives of families of comparisons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.statistics.designs import Sizes, draw_metres, draw_rates
from prbench.harness.clusters import SIGNIFICANCE, PerSet, mean_bounds, measure_spread, p_values, rate_bounds
from prbench.harness.run_folder.summary import bounds_of_mean

DATASETS = 5
"""Datasets of a mean over datasets, as in the study."""
COMPARISONS = 6
"""Comparisons of a family: one for each main metric."""
_AT_ONCE = 2_000  # data sets, so that the largest design needs some tens of megabytes


@dataclass(frozen=True)
class Share:
    """A share of simulated data sets."""

    share: float
    sets: int
    width: float = 0.0
    """Median width of the intervals, in the unit of the values."""

    @property
    def error(self) -> float:
        """Standard error of the share by simulation, at least that of one data set more or less."""
        return float(np.sqrt(max(self.share * (1 - self.share), 1 / self.sets) / self.sets))


def rate_coverage(sizes: Sizes, rate: float, correlation: float, *, sets: int, seed: int) -> Share:
    """Coverage of the intervals of a rate."""
    rng = np.random.default_rng(seed)
    _, low, high = _rates(rng, sizes, rate, correlation, sets)
    covered = (low <= rate) & (rate <= high)
    return Share(float(covered.mean()), sets, float(np.median(high - low)))


def mean_coverage(sizes: Sizes, kind: str, *, sets: int, seed: int) -> Share | None:
    """Coverage of the intervals of a mean; None where none is given."""
    rng = np.random.default_rng(seed)
    _, low, high = _means(rng, sizes, kind, sets)
    width = float(np.median(high - low))
    return None if np.isnan(width) else Share(float(((low <= 1) & (high >= 1)).mean()), sets, width)


def coverage_over_datasets(sizes: Sizes, kind: str | Sequence[float], *, sets: int, seed: int) -> Share:
    """Coverage of the intervals of a mean over five datasets, each of these recordings.

    Args:
        sizes: Sequences of each recording of a dataset.
        kind: A distribution of values with the mean 1, or the true rates of five datasets, with correlation 0.1.
        sets: Number of simulated means.
        seed: Of the simulation.
    """
    rng = np.random.default_rng(seed)
    if isinstance(kind, str):
        true = 1.0
        found = [_means(rng, sizes, kind, sets) for _ in range(DATASETS)]
    else:
        true = float(np.mean(kind))
        found = [_rates(rng, sizes, rate, 0.1, sets) for rate in kind]
    low, high = bounds_of_mean(*(np.stack(part) for part in zip(*found, strict=True)))
    covered = (low <= true) & (true <= high)
    return Share(float(covered.mean()), sets, float(np.median(high - low)))


def _rates(
    rng: np.random.Generator, sizes: Sizes, rate: float, correlation: float, sets: int
) -> tuple[PerSet, PerSet, PerSet]:
    """Draw data sets and return their rates with the bounds of their intervals."""
    totals = draw_rates(rng, sizes, rate, correlation, sets)
    n = int(sizes.sum())
    successes = totals.sum(axis=1)
    low = np.zeros(sets)
    high = np.ones(sets)
    # 0 % and 100 % have the interval of one trial a recording (prbench.harness.intervals.rate_interval).
    beyond = 1 - ((1 - 0.95) / 2) ** (1 / len(sizes))
    high[successes == 0] = beyond
    low[successes == n] = 1 - beyond
    mixed = (successes > 0) & (successes < n)
    low[mixed], high[mixed] = rate_bounds(totals[mixed], sizes)
    return successes / n, low, high


def _means(rng: np.random.Generator, sizes: Sizes, kind: str, sets: int) -> tuple[PerSet, PerSet, PerSet]:
    """Draw data sets with the true mean 1 and return their means with the bounds of their intervals."""
    parts = []
    for first in range(0, sets, _AT_ONCE):
        totals, variance = draw_metres(rng, sizes, kind, min(_AT_ONCE, sets - first))
        parts.append((totals.sum(axis=1) / sizes.sum(), *mean_bounds(measure_spread(totals, sizes, variance))))
    mean, low, high = (np.concatenate(part) for part in zip(*parts, strict=True))
    return mean, low, high


def false_positives(sizes: Sizes, kind: str, *, families: int, seed: int) -> Share | None:
    """Share of families of six independent comparisons with a finding, where no mean differs; None if untestable."""
    rng = np.random.default_rng(seed)
    smallest: list[np.ndarray] = []
    for first in range(0, families, _AT_ONCE):
        sets = COMPARISONS * min(_AT_ONCE, families - first)
        p = np.asarray(_p_values_of_no_difference(rng, sizes, kind, sets))
        smallest.append(p.reshape(-1, COMPARISONS).min(axis=1))
    found = np.concatenate(smallest)
    # Holm rejects at least one hypothesis if and only if the smallest p-value is below a sixth of the level.
    return None if np.isnan(found).any() else Share(float((found <= SIGNIFICANCE / COMPARISONS).mean()), families)


def _p_values_of_no_difference(rng: np.random.Generator, sizes: Sizes, kind: str, sets: int) -> PerSet:
    if kind == "rates":
        # Two methods with the same rate of 30 %, whose successes are unrelated given the recording.
        totals = draw_rates(rng, sizes, 0.3, 0.1, sets) - draw_rates(rng, sizes, 0.3, 0.1, sets)
        return p_values(measure_spread(totals, sizes))
    totals, variance = draw_metres(rng, sizes, kind, sets)
    return p_values(measure_spread(totals - sizes, sizes, variance))
