"""Confidence intervals that know that sequences of one recording are not independent.

Source: docs/specification/protocol.md#intervals.

Every estimate is the mean over sequences (of the mean over samples, where a sequence has several), and every interval
is that of this estimator: its spread is that between recordings, which holds what sequences and samples add to it.

* **Rates** get Clopper's and Pearson's interval with an effective number of sequences. Where all values are equal,
  nothing is known about the correlation; then every recording is one trial, so that 0 % and 100 % never claim
  certainty.
* **Metres and ratios** get Student's interval with the CR2 variance and Satterthwaite's degrees of freedom, joined with
  Hall's, which allows for skewness. Where too few recordings or equal values allow none, none is given.
* **Differences of rates** get the latter, joined with an interval that is made of those of gains and losses, since few
  sequences that differ do not show the spread of many.

The formulas stand in :mod:`prbench.harness.clusters`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from prbench.harness.clusters import (
    CONFIDENCE,
    SIGNIFICANCE,
    Spread,
    detectable_difference,
    mean_bounds,
    measure_spread,
    p_values,
    rate_bounds,
)
from prbench.metrics import MetricInfo

# One name a row.
Ids = Sequence[str] | np.ndarray
_MANY_RECORDINGS = 10
# Values no farther apart are equal: what arithmetic alone makes of them is never printed, and decides nothing.
EQUAL_WITHIN = 1e-5
_FEW_RECORDINGS = "few_recordings"
_ONE_RECORDING = "one_recording"
_ALL_EQUAL = "all_equal"
RATE_INTERVAL = "clopper-pearson-cluster"
EQUAL_RATES_INTERVAL = "clopper-pearson-recordings"
MEAN_INTERVAL = "student-hall-cluster"
DIFFERENCE_INTERVAL = "student-hall-newcombe-cluster"
NO_INTERVAL = "none"


@dataclass(frozen=True)
class Estimate:
    """A mean over sequences with its 95 % interval.

    Attributes:
        mean: The mean.
        low: None where the data do not support an interval.
        high: Upper bound of the interval.
        n_sequences: Number of sequences.
        n_recordings: Number of recordings that they come from.
        method: Name of the interval, such as :data:`RATE_INTERVAL`.
        marks: ``few_recordings`` (below ten), ``one_recording``, ``all_equal``.
    """

    mean: float
    low: float | None
    high: float | None
    n_sequences: int
    n_recordings: int
    method: str
    marks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ClusteredValues:
    """Values grouped by sequence and recording, in an order that does not depend on that of the rows.

    Attributes:
        samples: Rows (samples) of each sequence; its rows stand together.
        sequences: Sequences of each recording; they stand together.
    """

    values: Float[np.ndarray, " rows"]
    samples: Int[np.ndarray, " sequences"]
    sequences: Int[np.ndarray, " recordings"]

    @property
    def sequence_means(self) -> Float[np.ndarray, " sequences"]:
        """Mean over the samples of each sequence."""
        return np.add.reduceat(self.values, _starts(self.samples)) / self.samples

    @property
    def totals(self) -> Float[np.ndarray, " recordings"]:
        """Sum of the sequence means of each recording."""
        return np.add.reduceat(self.sequence_means, _starts(self.sequences))

    @property
    def sequence_variance(self) -> float:
        """Variance between all sequences, whatever their recordings; 0 of a single one."""
        means = self.sequence_means
        return float(means.var(ddof=1)) if len(means) > 1 else 0.0

    @property
    def spread(self) -> Spread:
        """The error of the mean, as far as the data tell it."""
        return measure_spread(self.totals, self.sequences, self.sequence_variance)

    @property
    def mean(self) -> float:
        """Mean over sequences, the estimate itself."""
        return float(self.totals.sum() / self.sequences.sum())

    @property
    def marks(self) -> tuple[str, ...]:
        """Remarks that a reader of the interval needs."""
        count = len(self.sequences)
        found = {
            _ONE_RECORDING: count == 1,
            _FEW_RECORDINGS: count < _MANY_RECORDINGS,
            _ALL_EQUAL: bool(np.ptp(self.values) <= EQUAL_WITHIN),
        }
        return tuple(mark for mark, holds in found.items() if holds)

    def estimate(self, low: float | None, high: float | None, method: str) -> Estimate:
        """Put the mean and an interval of it together."""
        return Estimate(self.mean, low, high, len(self.samples), len(self.sequences), method, self.marks)


def clustered(
    values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None
) -> ClusteredValues:
    """Group values by recording and sequence.

    Args:
        values: One a row.
        recording_ids: The recording that each row's sequence comes from.
        sequence_ids: The sequence of each row, where a sequence has several samples; by default every row is one.

    Raises:
        ValueError: without values, for values that are not finite, columns of unequal lengths, or a sequence that
            belongs to two recordings.
    """
    if len(values) == 0:
        raise ValueError("no values to estimate from")
    if not np.isfinite(values).all():
        raise ValueError(f"row {np.flatnonzero(~np.isfinite(values))[0]}: the value is not finite")
    sequences = np.arange(len(values)) if sequence_ids is None else np.asarray(sequence_ids)
    if not len(values) == len(recording_ids) == len(sequences):
        raise ValueError("values, recording ids and sequence ids differ in number")
    recording = np.unique(np.asarray(recording_ids), return_inverse=True)[1]
    sequence = np.unique(sequences, return_inverse=True)[1]
    # Sorted by values last, so that the order of rows leaves no trace in rounded sums.
    order = np.lexsort((values, sequence, recording) if sequence_ids is not None else (values, recording))
    pairs = np.stack([recording, sequence])[:, order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(pairs) != 0).any(axis=0)]))
    if len(first) != sequence.max() + 1:
        raise ValueError("a sequence belongs to two recordings")
    return ClusteredValues(
        values[order].astype(np.float64), np.diff(np.append(first, len(values))), np.bincount(pairs[0, first])
    )


def metric_interval(
    info: MetricInfo, values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None
) -> Estimate:
    """Return the interval that fits a metric; arguments as those of :func:`clustered`."""
    if info.unit == "rate":
        return rate_interval(values, recording_ids, sequence_ids)
    return mean_interval(values, recording_ids, sequence_ids, nonnegative=not info.can_be_negative)


def rate_interval(values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None) -> Estimate:
    """Mean of a rate (values from 0 to 1) over sequences; arguments as :func:`clustered`."""
    if ((values < 0) | (values > 1)).any():
        raise ValueError("a rate has values from 0 to 1")
    data = clustered(values, recording_ids, sequence_ids)
    # All values are equal: their spread says nothing about how alike sequences of one recording are.
    if min(data.mean, 1 - data.mean) <= EQUAL_WITHIN:
        bound = ((1 - CONFIDENCE) / 2) ** (1 / len(data.sequences))
        low, high = (0.0, 1 - bound) if round(data.mean) == 0 else (bound, 1.0)
        return data.estimate(low, high, EQUAL_RATES_INTERVAL)
    low, high = rate_bounds(data.totals, data.sequences)
    return data.estimate(float(low), float(high), RATE_INTERVAL)


def mean_interval(
    values: Float[np.ndarray, " rows"],
    recording_ids: Ids,
    sequence_ids: Ids | None = None,
    *,
    nonnegative: bool = False,
) -> Estimate:
    """Mean over sequences, with an interval from the spread between recordings; arguments as :func:`clustered`.

    Args:
        values: One a row.
        recording_ids: One a row.
        sequence_ids: One a row, or None.
        nonnegative: The quantity cannot fall below 0, so its interval is cut there.
    """
    data = clustered(values, recording_ids, sequence_ids)
    # Equal values do not show their spread.
    low, high = (np.nan, np.nan) if _ALL_EQUAL in data.marks else mean_bounds(data.spread)
    if np.isnan(low):
        return data.estimate(None, None, NO_INTERVAL)
    return data.estimate(max(float(low), 0.0) if nonnegative else float(low), float(high), MEAN_INTERVAL)


def difference_interval(
    first: Float[np.ndarray, " rows"], second: Float[np.ndarray, " rows"], recording_ids: Ids, *, rate: bool
) -> Estimate:
    """Mean of first - second over sequences, with an interval; both methods on the same sequences.

    Where few sequences differ, the spread of a rate's differences is unknown, as that of a rate near 0 is. So the
    interval reaches at least as far as that of the share of gains minus the share of losses, made of the intervals of
    both (Newcombe 1998, "square and add").

    Args:
        first: One a sequence.
        second: One a sequence.
        recording_ids: One a sequence.
        rate: The values are rates, from 0 to 1.
    """
    difference = first - second
    plain = mean_interval(difference, recording_ids)
    if not rate:
        return plain
    gains = rate_interval(np.maximum(difference, 0.0), recording_ids)
    losses = rate_interval(np.maximum(-difference, 0.0), recording_ids)
    # Gains and losses exclude one another, so they are correlated below 0, which widens their difference.
    odds = gains.mean / max(1 - gains.mean, EQUAL_WITHIN) * losses.mean / max(1 - losses.mean, EQUAL_WITHIN)
    correlation = min(np.sqrt(odds), 1.0)
    # A rate always has an interval.
    fewer_gains, more_gains = _reaches(gains)
    fewer_losses, more_losses = _reaches(losses)

    def joined(first: float, second: float) -> float:
        return float(np.sqrt(first**2 + second**2 + 2 * correlation * first * second))

    low = plain.mean - joined(fewer_gains, more_losses)
    high = plain.mean + joined(more_gains, fewer_losses)
    if plain.low is not None and plain.high is not None:
        low = min(low, plain.low)
        high = max(high, plain.high)
    return replace(plain, low=max(float(low), -1.0), high=min(float(high), 1.0), method=DIFFERENCE_INTERVAL)


def _reaches(rate: Estimate) -> tuple[float, float]:
    """How far an interval reaches down and up from the mean."""
    assert rate.low is not None
    assert rate.high is not None
    return rate.mean - rate.low, rate.high - rate.mean


def _starts(counts: np.ndarray) -> np.ndarray:
    return np.cumsum(counts) - counts


# Probability with which the smallest detectable difference would be found.
POWER = 0.8

Conclusion = Literal["higher", "lower", "not supported by the data", "cannot be tested"]


@dataclass(frozen=True, eq=False)
class PairedValues:
    """One metric of two methods on the same sequences; each value the mean over the samples of a sequence.

    Attributes:
        rate: The values are rates, from 0 to 1.
    """

    first: Float[np.ndarray, " sequences"]
    second: Float[np.ndarray, " as_many"]
    recording_ids: Ids
    rate: bool = False


@dataclass(frozen=True)
class Comparison:
    """The difference first - second, and whether the data support one.

    Attributes:
        difference: Mean difference over sequences with its interval.
        p_value: Two-sided; None where it cannot be tested.
        adjusted_p_value: After Holm's correction for all comparisons made together.
        detectable: Smallest difference that is found with 80 % power at Holm's first step; None where none can be.
    """

    difference: Estimate
    p_value: float | None
    adjusted_p_value: float | None
    detectable: float | None = None

    @property
    def conclusion(self) -> Conclusion:
        """Words for the result: is the first method higher or lower than the second at a family-wise 5 %?"""
        if self.adjusted_p_value is None:
            return "cannot be tested"
        if self.adjusted_p_value > SIGNIFICANCE:
            return "not supported by the data"
        return "higher" if self.difference.mean > 0 else "lower"


def compare(pairs: Mapping[str, PairedValues]) -> dict[str, Comparison]:
    """Compare pairs of methods (or one pair on several metrics or datasets), corrected for their number.

    Args:
        pairs: The comparisons, by any name.

    Raises:
        ValueError: if the two methods of a pair were not scored on equally many sequences.
    """
    for name, pair in pairs.items():
        if len(pair.first) != len(pair.second):
            raise ValueError(f"{name}: {len(pair.first)} values of the first method, {len(pair.second)} of the second")
    values = list(pairs.values())
    unadjusted = [paired_p_value(pair.first - pair.second, pair.recording_ids) for pair in values]
    adjusted = holm(unadjusted)
    family = max(sum(p is not None for p in unadjusted), 1)
    found = {}
    for name, pair, p_value, adjusted_p_value in zip(pairs, values, unadjusted, adjusted, strict=True):
        found[name] = Comparison(
            difference=difference_interval(pair.first, pair.second, pair.recording_ids, rate=pair.rate),
            p_value=p_value,
            adjusted_p_value=adjusted_p_value,
            detectable=smallest_detectable(pair.first - pair.second, pair.recording_ids, comparisons=family),
        )
    return found


def smallest_detectable(
    values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None, *, comparisons: int
) -> float | None:
    """Smallest difference that would be found with 80 % power at Holm's first step, from the recordings' spread.

    Args:
        values: Differences of two methods; only their spread counts.
        recording_ids: One a row.
        sequence_ids: See :func:`clustered`.
        comparisons: Number of comparisons made together.

    Returns:
        In the unit of the differences; None where nothing can be tested or the values are equal.
    """
    data = clustered(values, recording_ids, sequence_ids)
    if _ALL_EQUAL in data.marks:
        return None
    found = float(detectable_difference(data.spread, comparisons=comparisons, power=POWER))
    return None if np.isnan(found) else found


def smallest_detectable_unpaired(
    values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids, *, comparisons: int
) -> float | None:
    """Like :func:`smallest_detectable`, for the difference to an unrelated method of the same spread as this one."""
    found = smallest_detectable(values, recording_ids, sequence_ids, comparisons=comparisons)
    return None if found is None else float(np.sqrt(2) * found)


def paired_p_value(differences: Float[np.ndarray, " sequences"], recording_ids: Ids) -> float | None:
    """Two-sided p-value of the mean difference being 0, from the spread between recordings.

    Differences that agree within 10 µm (or as little of another unit) show no spread. Then each recording is one coin:
    the p-value is that of a sign test. Mean differences as small are none.

    Returns:
        None where it cannot be tested: below six recordings, or where one recording outweighs all others.
    """
    data = clustered(differences, recording_ids)
    p_value = float(p_values(data.spread))
    if np.isnan(p_value):
        return None
    if abs(data.mean) <= EQUAL_WITHIN:
        return 1.0
    if "all_equal" in data.marks:
        return 2.0 ** (1 - len(data.sequences))
    return p_value


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's step-down correction; comparisons without a p-value are no part of the family."""
    present = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, i) in enumerate(present):
        largest = max(largest, min(1.0, p * (len(present) - rank)))
        adjusted[i] = largest
    return adjusted
