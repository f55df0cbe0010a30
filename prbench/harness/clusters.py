"""The mean over sequences of several recordings: its spread, its skewness, and what they say about it.

Source: docs/specification/protocol.md#intervals and #comparisons.

The functions take the totals of recordings, not single sequences, with any number of leading axes: the simulation
(``benchmarks/statistics``) sends thousands of data sets at once through the functions that print a
run's intervals.

Notation: recording i has n_i sequences whose values add up to y_i; N = sum n_i; the mean over sequences is
m = sum y_i / N; its residuals are e_i = y_i - n_i m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import special

# One number for each data set: an array with the leading axes, or a single number where there are none.
PerSet = np.ndarray | np.floating
CONFIDENCE = 0.95
SIGNIFICANCE = 0.05
# Recordings: with two, the spread rests on a single difference.
FEWEST_FOR_MEAN = 3
# Recordings below which neither skewness nor spread is known well enough for a p-value.
FEWEST_FOR_TEST = 6
_FEWEST_DEGREES = 1.5  # of freedom: below, one recording outweighs all others together
_UNSEEN_TAIL = 5.0  # recordings; see `_tail_share`
_UNSEEN_SKEWNESS = 1.5  # times the measured one in the test: the tail that is not seen is skewness that is not measured
_LARGEST_CORRELATION = 0.3  # within recordings, assumed where a single recording holds all events
_TINY = 1e-300
_CERTAIN = 1e9  # standard errors, so that powers of them are finite


@dataclass(frozen=True, eq=False)
class Spread:
    """The estimate with what is known about its error; arrays have the shape of the leading axes.

    Attributes:
        error: Standard error of the mean (CR2 of Bell and McCaffrey 2002), at least that of independent sequences.
        skewness: Skewness of the estimate: that of the recordings' residuals, over the root of their number.
        degrees: Satterthwaite's degrees of freedom of the squared error; 0 with one recording.
        carriers: Number of recordings that the measured spread rests on: all if they deviate alike, 1 if one deviates.
    """

    mean: PerSet
    error: PerSet
    skewness: PerSet
    degrees: float
    carriers: PerSet
    recordings: int


def measure_spread(
    totals: Float[np.ndarray, "*sets recordings"],
    sizes: Int[np.ndarray, " recordings"],
    sequence_variance: Float[np.ndarray, "*sets"] | float = 0.0,
) -> Spread:
    """Measure how far the mean over sequences may be off.

    Args:
        totals: Sum over the sequences of each recording.
        sizes: Number of sequences of each recording.
        sequence_variance: Variance between all sequences, whatever their recordings, which sets the least error.
    """
    count = len(sizes)
    n = float(sizes.sum())
    share = sizes / n
    mean = totals.sum(axis=-1) / n
    if count < 2:
        nothing = np.full(np.shape(mean), np.nan)
        return Spread(mean, nothing, nothing, 0.0, nothing, count)
    # CR2: the residual of a large recording is too small, because the recording itself pulls the mean to it.
    residuals = (totals - mean[..., None] * sizes) / np.sqrt(1 - share)
    squares = residuals**2
    between = squares.sum(axis=-1)
    error = np.sqrt(np.maximum(between / n**2, np.asarray(sequence_variance) / n))
    correction = count / (count - 2) if count > 2 else 1.0  # samples this small show less skewness than there is
    spread = np.sqrt(np.where(between > 0, between, 1.0))[..., None]
    relative = residuals / spread
    skewness = correction * (relative**3).sum(axis=-1)
    carriers = np.where(between > 0, 1 / np.maximum((relative**4).sum(axis=-1), 1 / count), float(count))
    return Spread(mean, error, skewness, degrees_of_freedom(sizes), carriers, count)


def degrees_of_freedom(sizes: Int[np.ndarray, " recordings"]) -> float:
    """Satterthwaite's degrees of freedom of the CR2 variance (Bell and McCaffrey 2002).

    They depend on how alike sequences of one recording are, which is unknown. The smaller number of the two extremes,
    independent sequences and equal ones, is returned.
    """
    n = sizes.sum()
    share = sizes / n
    weight = 1 / np.sqrt(1 - share)
    same = np.eye(len(sizes))
    independent = np.diag(sizes.astype(np.float64)) - np.outer(sizes, sizes) / n
    equal = np.outer(sizes, sizes) * (same - share[:, None] - share[None, :] + (share**2).sum())
    found = []
    for covariance in (independent, equal):
        weighted = weight[:, None] * weight[None, :] * covariance
        found.append(float(np.trace(weighted) ** 2 / (weighted**2).sum()))
    return min(found)


def mean_bounds(spread: Spread) -> tuple[PerSet, PerSet]:
    """Return the 95 % interval of a mean; NaN where none can be given.

    Student's interval and Hall's (1992) are joined: the latter undoes the skewness by a monotone cubic function of the
    studentised mean. Recordings that happen not to show their tail look less skewed than they are, so fewer recordings
    are asked for more (:func:`_tail_share`).
    """
    if spread.recordings < FEWEST_FOR_MEAN or spread.degrees < _FEWEST_DEGREES:
        nothing = np.full(np.shape(spread.mean), np.nan)
        return nothing, nothing
    tail = (1 - CONFIDENCE) / 2 * _tail_share(spread.recordings)
    reach = float(special.stdtrit(spread.degrees, 1 - tail))
    lowest = np.minimum(-reach, -_without_skewness(reach, spread.skewness))
    highest = np.maximum(reach, -_without_skewness(-reach, spread.skewness))
    return spread.mean + lowest * spread.error, spread.mean + highest * spread.error


def p_values(spread: Spread) -> PerSet:
    """Two-sided p-values of the mean being 0; NaN where it cannot be tested.

    The smaller of Student's and Hall's statistic counts; the latter takes half as much skewness again as is measured,
    because few recordings show less than there is. The degrees of freedom are at most the number of recordings that the
    measured spread rests on: Holm's first step asks for tails far out, where a spread that is that of a few recordings
    is worth no more than those.
    """
    if spread.recordings < FEWEST_FOR_TEST or spread.degrees < _FEWEST_DEGREES:
        return np.full(np.shape(spread.mean), np.nan)
    studentised = np.clip(spread.mean / np.maximum(spread.error, _TINY), -_CERTAIN, _CERTAIN)
    # Hall's (1992) transformation: its result is nearly symmetric where the studentised mean is not.
    skewness = _UNSEEN_SKEWNESS * spread.skewness
    t = studentised
    symmetric = t + skewness * t**2 / 3 + skewness**2 * t**3 / 27 + skewness / 6
    statistic = np.minimum(np.abs(studentised), np.abs(symmetric))
    both_tails = 2 * special.stdtr(test_degrees(spread), -statistic)
    return np.minimum(both_tails / _tail_share_of_test(spread.recordings), 1.0)


def detectable_difference(spread: Spread, *, comparisons: int, power: float) -> PerSet:
    """Smallest difference that would be found with this power at Holm's first step; NaN where none can be.

    Args:
        spread: Spread of the differences of two methods.
        comparisons: Number of comparisons made together.
        power: Such as 0.8.
    """
    if spread.recordings < FEWEST_FOR_TEST or spread.degrees < _FEWEST_DEGREES:
        return np.full(np.shape(spread.mean), np.nan)
    degrees = test_degrees(spread)
    tail = SIGNIFICANCE / 2 / comparisons * _tail_share_of_test(spread.recordings)
    return (special.stdtrit(degrees, 1 - tail) + special.stdtrit(degrees, power)) * spread.error


def test_degrees(spread: Spread) -> PerSet:
    """Degrees of freedom of the test: Satterthwaite's, or the number of recordings that carry the spread if fewer."""
    return np.maximum(np.minimum(spread.degrees, spread.carriers), 1.0)


test_degrees.__test__ = False  # type: ignore[attr-defined]  # pytest takes imported names with "test_" for tests


def rate_bounds(
    totals: Float[np.ndarray, "*sets recordings"], sizes: Int[np.ndarray, " recordings"]
) -> tuple[PerSet, PerSet]:
    """Return the 95 % interval of a rate strictly between 0 and 1: Clopper's and Pearson's of the effective number."""
    number = effective_number(totals, sizes)
    events = totals.sum(axis=-1) / sizes.sum() * number
    tail = (1 - CONFIDENCE) / 2
    low = special.betaincinv(events, number - events + 1, tail)
    high = special.betaincinv(events + 1, number - events, 1 - tail)
    return low, high


def effective_number(totals: Float[np.ndarray, "*sets recordings"], sizes: Int[np.ndarray, " recordings"]) -> PerSet:
    """Return the number of independent sequences whose rate would be known as well (rates neither 0 nor 1).

    The sequences are divided by the design effect, the variance of the mean over what it were if all sequences were
    independent. Two things keep it from being too small. A rate whose events come from few recordings says little
    about how alike the sequences of one are, so a correlation is assumed, the larger the fewer recordings hold events.
    And a spread that rests on few recordings costs degrees of freedom (Korn and Graubard 1998). However correlated
    the sequences, recordings count for no less than as many independent sequences of their sizes (Kish).
    """
    count = len(sizes)
    n = float(sizes.sum())
    weighted_size = float((sizes.astype(np.float64) ** 2).sum()) / n
    at_least = n / weighted_size
    mean = totals.sum(axis=-1) / n
    if count < 2:
        return np.full(np.shape(mean), at_least)
    share = sizes / n
    squares = (totals - mean[..., None] * sizes) ** 2 / (1 - share)
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


def _tail_share(recordings: int) -> float:
    """Share of the nominal tail that is used: recordings / (recordings + 5), found by simulation.

    Skewed recordings hide their tail the likelier the fewer they are; then spread and skewness are both measured too
    small, and no function of the data can tell. In intervals 97.5 % becomes 99.1 % with 3 recordings, 97.7 % with 47.
    """
    return recordings / (recordings + _UNSEEN_TAIL)


def _tail_share_of_test(recordings: int) -> float:
    """Return the tail share of p-values, cubed: Holm asks for tails that few recordings show still later."""
    return _tail_share(recordings) ** 3


def _without_skewness(transformed: float, skewness: PerSet) -> PerSet:
    """Inverse of :func:`_with_skewness`, which is monotone in the studentised mean."""
    a = np.where(np.abs(skewness) < 1e-6, 1e-6, skewness)  # the limit of no skewness, without dividing by 0
    return 3 / a * (np.cbrt(1 + a * (transformed - a / 6)) - 1)
