"""Simulated data sets, and what one cell of the grid measures on them: coverage, width, false positives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.harness.clusters import SIGNIFICANCE, PerSet, mean_bounds, measure_spread, p_values, rate_bounds
from prbench.harness.run_folder.summary import bounds_of_mean

Sizes = Int[np.ndarray, " recordings"]
RATES = (0.02, 0.1, 0.5, 0.9, 0.98)
CORRELATIONS = (0.0, 0.1, 0.3)
METRES = ("normal", "gamma", "exponential", "lognormal", "unequal-spread")
# Kinds on which no constant of the test was chosen (docs/specification/protocol.md#simulation).
UNUSED_METRES = ("half-gamma", "outliers", "outliers-above")


def uneven(recordings: int, sequences: int, seed: int) -> Sizes:
    """Sizes of recordings with one sequence or more, the others shared out by exponential weights."""
    rng = np.random.default_rng(seed)
    weight = rng.exponential(1.0, recordings)
    return 1 + rng.multinomial(sequences - recordings, weight / weight.sum())


DESIGNS: dict[str, Sizes] = {
    "3 of 10": np.full(3, 10),
    "3 of 60": np.full(3, 60),
    "8 of 3": np.full(8, 3),
    "8 of 20": np.full(8, 20),
    "8 of 60": np.full(8, 60),
    "11 uneven of 55": uneven(11, 55, 2),
    "22 of 1": np.full(22, 1),
    "22 of 8": np.full(22, 8),
    "22 of 60": np.full(22, 60),
    "22 uneven of 70": uneven(22, 70, 9),
    "47 of 1": np.full(47, 1),
    "47 of 8": np.full(47, 8),
    "47 uneven of 117": uneven(47, 117, 3),
}

# Ten sequences of seven recordings, as a run without ``--data`` takes them.
FIRST_RUN: Sizes = np.array([2, 2, 2, 1, 1, 1, 1])
# Share of recordings that are outliers, where a kind has any.
OUTLIERS = 0.1


def draw_rates(
    rng: np.random.Generator, sizes: Sizes, rate: float, correlation: float, sets: int
) -> Float[np.ndarray, "sets recordings"]:
    """Draw successes of each recording; rates of recordings follow a beta distribution with this correlation."""
    if correlation > 0:
        strength = (1 - correlation) / correlation
        of_recordings = rng.beta(rate * strength, (1 - rate) * strength, (sets, len(sizes)))
    else:
        of_recordings = np.full((sets, len(sizes)), rate)
    return rng.binomial(sizes, of_recordings).astype(np.float64)


def draw_metres(
    rng: np.random.Generator, sizes: Sizes, kind: str, sets: int
) -> tuple[Float[np.ndarray, "sets recordings"], Float[np.ndarray, " sets"]]:
    """Draw values with the true mean 1; return totals of recordings and the variance between sequences.

    Args:
        rng: Source of randomness.
        sizes: Sequences of each recording.
        kind: One of :data:`METRES`; all but ``normal`` are skewed. ``unequal-spread``: recordings differ the more, the
            more sequences they have, and to one side. ``lognormal`` has a skewness of 6. Or one of
            :data:`UNUSED_METRES`: ``half-gamma`` has shape 1/2 and a skewness of 2.8. ``outliers``: a tenth of the
            recordings are ten times as far from the mean as the others, to both sides. ``outliers-above``: a tenth of
            them are ten standard deviations above the others.
        sets: Number of data sets.
    """
    count = len(sizes)
    n = int(sizes.sum())
    recording = np.repeat(np.arange(count), sizes)
    if kind == "normal":
        values = 1 + rng.normal(0, 1, (sets, count))[:, recording] + rng.normal(0, 1, (sets, n))
    elif kind == "gamma":
        values = rng.gamma(2, 0.5, (sets, count))[:, recording] * rng.gamma(4, 0.25, (sets, n))
    elif kind == "exponential":
        values = rng.exponential(1, (sets, count))[:, recording]
    elif kind == "lognormal":
        between = np.exp(rng.normal(0, 1, (sets, count)) - 0.5)
        values = between[:, recording] * np.exp(rng.normal(0, 0.5, (sets, n)) - 0.125)
    elif kind == "unequal-spread":
        between = (rng.exponential(1, (sets, count)) - 1) * np.sqrt(sizes / sizes.mean())
        values = 1 + between[:, recording] + rng.normal(0, 1, (sets, n))
    elif kind == "half-gamma":
        values = rng.gamma(0.5, 2, (sets, count))[:, recording] * rng.gamma(4, 0.25, (sets, n))
    elif kind in ("outliers", "outliers-above"):
        is_outlier = rng.random((sets, count)) < OUTLIERS
        between = rng.normal(0, 1, (sets, count))
        if kind == "outliers":
            between = np.where(is_outlier, 10 * between, between)
        else:
            between = between + 10 * (is_outlier - OUTLIERS)
        values = 1 + between[:, recording] + rng.normal(0, 1, (sets, n))
    else:
        raise ValueError(f"unknown kind '{kind}'; known ones are: {', '.join((*METRES, *UNUSED_METRES))}")
    totals = np.add.reduceat(values, np.cumsum(sizes) - sizes, axis=1)
    return totals, values.var(axis=1, ddof=1)


# Datasets of a mean over datasets, as in the study.
DATASETS = 5
# Comparisons of a family: one for each main metric.
COMPARISONS = 6
_AT_ONCE = 2_000  # data sets, so that the largest design needs some tens of megabytes


@dataclass(frozen=True)
class Share:
    """A share of simulated data sets.

    Attributes:
        width: Median width of the intervals, in the unit of the values.
    """

    share: float
    sets: int
    width: float = 0.0

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
        seed: Seed of the simulation.
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
        if kind == "rates":
            # Two methods with the same rate of 30 %, whose successes are unrelated given the recording.
            totals = draw_rates(rng, sizes, 0.3, 0.1, sets) - draw_rates(rng, sizes, 0.3, 0.1, sets)
            spread = measure_spread(totals, sizes)
        else:
            totals, variance = draw_metres(rng, sizes, kind, sets)
            spread = measure_spread(totals - sizes, sizes, variance)
        smallest.append(np.asarray(p_values(spread)).reshape(-1, COMPARISONS).min(axis=1))
    found = np.concatenate(smallest)
    # Holm rejects at least one hypothesis if and only if the smallest p-value is below a sixth of the level.
    return None if np.isnan(found).any() else Share(float((found <= SIGNIFICANCE / COMPARISONS).mean()), families)
