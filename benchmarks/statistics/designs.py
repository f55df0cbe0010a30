"""Designs (recordings and their sequences), and values drawn for them whose true mean is known."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

Sizes = Int[np.ndarray, " recordings"]
RATES = (0.02, 0.1, 0.5, 0.9, 0.98)
CORRELATIONS = (0.0, 0.1, 0.3)
METRES = ("normal", "gamma", "exponential", "lognormal", "unequal-spread")
UNUSED_METRES = ("half-gamma", "outliers", "outliers-above")
"""Kinds on which no constant of the test was chosen (docs/specification/protocol.md#simulation)."""


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

FIRST_RUN: Sizes = np.array([2, 2, 2, 1, 1, 1, 1])
"""Ten sequences of seven recordings, as a run without ``--data`` takes them."""
OUTLIERS = 0.1
"""Share of recordings that are outliers, where a kind has any."""


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
