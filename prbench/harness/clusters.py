"""Means over the sequences of several units: how far they may be off, and an exact test of a mean difference.

Source: docs/specification/protocol.md#intervals and #comparisons. Units are recordings, or participants where these are
tested in folds. The functions take the totals of units, with any number of leading axes: the simulation
(``benchmarks/statistics``) sends thousands of data sets at once through the functions that print a run's intervals.

Notation: unit i has n_i sequences whose values add up to y_i; N = sum n_i; the mean over sequences is m = sum y_i / N.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy import special

from prbench.randomness import named_generator

# One number for each data set: an array with the leading axes, or a single number where there are none.
PerSet = np.ndarray | np.floating
Totals = Float[np.ndarray, "*sets units"]
Sizes = Int[np.ndarray, " units"]
Variance = Float[np.ndarray, "*sets"] | float
CONFIDENCE = 0.95
SIGNIFICANCE = 0.05
# Probability with which the smallest detectable difference would be found.
POWER = 0.8
# Values no farther apart are equal: what arithmetic alone makes of them is never printed, and decides nothing.
EQUAL_WITHIN = 1e-5
# Units: with two, the spread rests on a single difference.
FEWEST_FOR_MEAN = 3
_FEWEST_DEGREES = 1.5  # of freedom: below, one unit outweighs all others together
_LARGEST_CORRELATION = 0.3  # within units, assumed where a single unit holds all events
_TINY = 1e-300
_GRID = 2.0**32


def units_needed(comparisons: int) -> int:
    """Return the fewest units that can support a difference at Holm's first step: 2 / 2^units <= 5 % / comparisons."""
    return int(np.ceil(np.log2(2 * comparisons / SIGNIFICANCE)))


# Units below which no board calls a method better: of two methods, compared by seven main metrics.
FEWEST_FOR_BOARD = units_needed(7)


@lru_cache(maxsize=2)
def flips(units: tuple[str, ...], most: int = 2**16) -> Float[np.ndarray, "units flips"]:
    """Return the flips of signs, but for the one that flips nothing: 1 where a unit's sign is flipped, else 0.

    All flips where there are no more than ``most``, else as many drawn ones. A unit's signs are drawn by its own name
    and nothing else, so that a further unit changes none of the others.

    Args:
        units: Different names of the units.
        most: Number of flips, with that which flips nothing.
    """
    if 2 ** len(units) <= most:
        return (np.arange(1, 2 ** len(units)) >> np.arange(len(units))[:, None] & 1).astype(np.float64)
    drawn = []
    for unit in units:
        generator = named_generator("sign-flips", hashlib.sha256(unit.encode()).hexdigest())
        drawn.append(np.unpackbits(np.frombuffer(generator.bytes(most // 8), np.uint8))[1:])
    flipped = np.array(drawn, dtype=np.float64)
    # Flipping nothing is counted once already; flipping everything is the same flip, seen from the other side.
    flipped[:, ~flipped.any(axis=0)] = 1
    return flipped


def flipped_means(
    totals: Totals, sizes: Sizes, flipped: Float[np.ndarray, "units flips"]
) -> Float[np.ndarray, "*sets flips"]:
    """Return the mean over the sequences of the flipped units, for each flip.

    The sum of y_i - d n_i with flipped signs is at least that without if and only if the mean of the flipped units is
    at most d. So these means are all that the test of any difference d needs (Hartigan 1969).
    """
    # Multiples of a fraction of a nanometre add up exactly, in whatever order and company a processor takes them.
    return np.rint(totals * _GRID) / _GRID @ flipped / (sizes @ flipped)


def flip_test(means: Float[np.ndarray, "*sets flips"]) -> PerSet:
    """Return the two-sided p-value of the mean difference being 0, exact if differences are symmetric about it.

    Args:
        means: Means of flipped units (:func:`flipped_means`).
    """
    low = 1 + (means <= EQUAL_WITHIN).sum(axis=-1)
    high = 1 + (means >= -EQUAL_WITHIN).sum(axis=-1)
    return np.minimum(2 * np.minimum(low, high) / (means.shape[-1] + 1), 1.0)


def flip_bounds(means: Float[np.ndarray, "*sets flips"], level: float = 1 - CONFIDENCE) -> tuple[PerSet, PerSet]:
    """Return the differences between which the flip test rejects none at this level.

    Args:
        means: Means of flipped units (:func:`flipped_means`), of so many that the test can reject at all.
        level: Two-sided level of the test.
    """
    count = means.shape[-1]
    place = max(int(level / 2 * (count + 1)) - 1, 0)
    ends = np.partition(means, (place, count - 1 - place), axis=-1)
    return ends[..., place], ends[..., count - 1 - place]


def detectable_difference(
    totals: Float[np.ndarray, " units"], sizes: Sizes, sequence_variance: float, *, comparisons: int, rate: bool = False
) -> float:
    """Return the smallest difference that four of five repetitions find at Holm's first step.

    Args:
        totals: Totals of units, of which only the spread counts.
        sizes: Number of sequences of each unit; no fewer units than :func:`units_needed`.
        sequence_variance: Variance between all sequences, whatever their units; above 0.
        comparisons: Number of comparisons made together.
        rate: Sequences succeed or fail, so that totals step by 1 and flips are tied, which half a step makes up for
            in the half of the sequences that a flip takes.
    """
    n = float(sizes.sum())
    error = float(standard_error(totals, sizes))
    # How alike sequences of one unit are matters where units have unequal sizes.
    correlation = 0.0
    if np.ptp(sizes):
        design_effect = error**2 / (sequence_variance / n)
        correlation = min(max((design_effect - 1) / ((sizes**2).sum() / n - 1), 0.0), 1.0)
    errors = _errors_found(tuple(sorted(sizes.tolist())), round(correlation, 1), SIGNIFICANCE / comparisons)
    return error * errors + rate / n


@lru_cache(maxsize=256)
def _errors_found(sizes: tuple[int, ...], correlation: float, level: float) -> float:
    """Return the smallest difference that is found, in standard errors measured beforehand, by trying the test out.

    In 800 repetitions with normal totals a difference is found if it is larger than the distance from the true mean to
    the lower bound. Another repetition brings the standard error, which nobody knows exactly.
    """
    number = np.array(sizes)
    deviation = np.sqrt(number * (1 + (number - 1) * correlation))
    totals = named_generator("smallest-difference").normal(size=(800, len(sizes))) * deviation
    low, _ = flip_bounds(flipped_means(totals, number, flips(tuple(map(str, range(len(sizes)))), 2**12)), level)
    return float(np.quantile(-low / np.roll(standard_error(totals, number), 1), POWER))


def standard_error(totals: Totals, sizes: Sizes, sequence_variance: Variance = 0.0) -> PerSet:
    """Return the standard error of the mean over sequences (CR2 of Bell and McCaffrey 2002), for two units or more.

    Args:
        totals: Sum over the sequences of each unit.
        sizes: Number of sequences of each unit.
        sequence_variance: Variance between all sequences, whatever their units, which sets the least error.
    """
    n = sizes.sum()
    residuals = totals - totals.sum(axis=-1, keepdims=True) / n * sizes
    # The residual of a large unit is too small, because the unit itself pulls the mean to it.
    between = (residuals**2 / (1 - sizes / n)).sum(axis=-1) / n**2
    return np.sqrt(np.maximum(between, np.asarray(sequence_variance) / n))


def degrees_of_freedom(sizes: Sizes) -> float:
    """Satterthwaite's degrees of freedom of the CR2 variance (Bell and McCaffrey 2002).

    They depend on how alike sequences of one unit are, which is unknown. The smaller number of the two extremes,
    independent sequences and equal ones, is returned.
    """
    n = sizes.sum()
    share = sizes / n
    independent = np.diag(sizes.astype(np.float64)) - np.outer(sizes, sizes) / n
    equal = np.outer(sizes, sizes) * (np.eye(len(sizes)) - share[:, None] - share[None, :] + (share**2).sum())
    found = []
    for covariance in (independent, equal):
        weighted = covariance / np.sqrt(np.outer(1 - share, 1 - share))
        found.append(float(np.trace(weighted) ** 2 / (weighted**2).sum()))
    return min(found)


def mean_bounds(
    totals: Totals, sizes: Sizes, sequence_variance: Variance = 0.0, *, nonnegative: bool = False
) -> tuple[PerSet, PerSet]:
    """Return Student's 95 % interval of a mean by the CR2 error; NaN where none can be given.

    Args:
        totals: Sum over the sequences of each unit.
        sizes: Number of sequences of each unit.
        sequence_variance: Variance between all sequences, whatever their units, which sets the least error.
        nonnegative: No value is below 0. Then large values may be rarer than those seen, and the upper bound is as
            far from the mean on a logarithmic scale.
    """
    mean = totals.sum(axis=-1) / sizes.sum()
    if len(sizes) < FEWEST_FOR_MEAN or degrees_of_freedom(sizes) < _FEWEST_DEGREES:
        nothing = np.full(np.shape(mean), np.nan)
        return nothing, nothing
    reach = special.stdtrit(degrees_of_freedom(sizes), 0.5 + CONFIDENCE / 2)
    reach = reach * standard_error(totals, sizes, sequence_variance)
    if nonnegative:
        return np.maximum(mean - reach, 0.0), mean * np.exp(reach / np.maximum(mean, _TINY))
    return mean - reach, mean + reach


def rate_bounds(totals: Totals, sizes: Sizes) -> tuple[PerSet, PerSet]:
    """Return the 95 % interval of a rate strictly between 0 and 1: Clopper's and Pearson's of the effective number."""
    number = effective_number(totals, sizes)
    events = totals.sum(axis=-1) / sizes.sum() * number
    tail = (1 - CONFIDENCE) / 2
    low = special.betaincinv(events, number - events + 1, tail)
    high = special.betaincinv(events + 1, number - events, 1 - tail)
    return low, high


def effective_number(totals: Totals, sizes: Sizes) -> PerSet:
    """Return the number of independent sequences whose rate would be known as well (rates neither 0 nor 1).

    The sequences are divided by the design effect, the variance of the mean over what it were if all sequences were
    independent. Two things keep it from being too small. A rate whose events come from few units says little about how
    alike the sequences of one are, so a correlation is assumed, the larger the fewer units hold events. And a spread
    that rests on few units costs degrees of freedom (Korn and Graubard 1998). However correlated the sequences, units
    count for no less than as many independent sequences of their sizes (Kish).
    """
    count = len(sizes)
    n = float(sizes.sum())
    weighted_size = float((sizes.astype(np.float64) ** 2).sum()) / n
    at_least = n / weighted_size
    mean = totals.sum(axis=-1) / n
    if count < 2:
        return np.full(np.shape(mean), at_least)
    squares = (totals - mean[..., None] * sizes) ** 2 / (1 - sizes / n)
    between = squares.sum(axis=-1)
    measured = between / n**2 / (mean * (1 - mean) / (n - 1))
    rarer = np.where((mean <= 0.5)[..., None], totals, sizes - totals)
    holders = rarer.sum(axis=-1) ** 2 / np.maximum((rarer**2).sum(axis=-1), _TINY)
    assumed = 1 + (weighted_size - 1) * _LARGEST_CORRELATION / np.maximum(holders, 1.0) ** 2
    design_effect = np.maximum(np.maximum(measured, assumed), 1.0)
    fourth = (squares**2).sum(axis=-1)
    carriers = np.where(measured > 1, between**2 / np.maximum(fourth, _TINY), float(count))
    degrees = np.maximum(np.minimum(at_least - 1, carriers), 1.0)
    upper = 0.5 + CONFIDENCE / 2
    few = (special.stdtrit(n - 1, upper) / special.stdtrit(degrees, upper)) ** 2
    return np.maximum(n / design_effect * few, at_least)
