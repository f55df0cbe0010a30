"""Confidence intervals and comparisons that know that sequences of one recording are not independent.

Source: docs/specification/protocol.md#intervals. The formulas stand in :mod:`prbench.harness.clusters`.

Every estimate is the mean over sequences (of the mean over samples, where a sequence has several). Its units are
recordings, or whatever a caller names as independent, such as participants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from prbench.harness.clusters import (
    CONFIDENCE,
    EQUAL_WITHIN,
    SIGNIFICANCE,
    detectable_difference,
    flip_bounds,
    flip_test,
    flipped_means,
    flips,
    mean_bounds,
    rate_bounds,
    units_needed,
)
from prbench.metrics import MetricInfo

# One name a row.
Ids = Sequence[str] | np.ndarray
_MANY_RECORDINGS = 10
_ALL_EQUAL = "all_equal"
RATE_INTERVAL = "clopper-pearson-cluster"
EQUAL_RATES_INTERVAL = "clopper-pearson-recordings"
MEAN_INTERVAL = "student-cr2"
DIFFERENCE_INTERVAL = "sign-flip"
NO_INTERVAL = "none"


@dataclass(frozen=True)
class Estimate:
    """A mean over sequences with its 95 % interval.

    Attributes:
        mean: The mean.
        low: None where the data do not support an interval.
        high: Upper bound of the interval.
        n_sequences: Number of sequences.
        n_recordings: Number of units that they come from.
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
    """Values of sequences grouped by unit, in an order that does not depend on that of the rows.

    Attributes:
        values: Mean over the samples of each sequence; those of one unit stand together.
        sizes: Sequences of each unit.
        units: Name of each unit.
    """

    values: Float[np.ndarray, " sequences"]
    sizes: Int[np.ndarray, " units"]
    units: tuple[str, ...]

    @property
    def totals(self) -> Float[np.ndarray, " units"]:
        """Sum of the values of each unit."""
        return np.add.reduceat(self.values, np.cumsum(self.sizes) - self.sizes)

    @property
    def mean(self) -> float:
        """Mean over sequences, the estimate itself."""
        return float(self.totals.sum() / self.sizes.sum())

    @property
    def variance(self) -> float:
        """Variance between all sequences, whatever their units; 0 of a single one."""
        return float(self.values.var(ddof=1)) if len(self.values) > 1 else 0.0

    @property
    def all_equal(self) -> bool:
        """All values are equal, so that they show no spread."""
        return bool(np.ptp(self.values) <= EQUAL_WITHIN)

    def estimate(self, bounds: tuple[float, float], method: str) -> Estimate:
        """Put the mean and an interval of it together; bounds that are not finite are none."""
        count = len(self.sizes)
        found = {"one_recording": count == 1, "few_recordings": count < _MANY_RECORDINGS, _ALL_EQUAL: self.all_equal}
        marks = tuple(mark for mark, holds in found.items() if holds)
        low, high = map(float, bounds)
        if not np.isfinite([low, high]).all():
            return Estimate(self.mean, None, None, len(self.values), count, NO_INTERVAL, marks)
        return Estimate(self.mean, low, high, len(self.values), count, method, marks)


def clustered(
    values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None
) -> ClusteredValues:
    """Group values by sequence and unit.

    Args:
        values: One a row.
        recording_ids: The unit, such as the recording, that each row's sequence comes from.
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
    units, unit = np.unique(np.asarray(recording_ids), return_inverse=True)
    sequence = np.unique(sequences, return_inverse=True)[1]
    # Sorted by values last, so that the order of rows leaves no trace in rounded sums.
    order = np.lexsort((values, sequence, unit) if sequence_ids is not None else (values, unit))
    pairs = np.stack([unit, sequence])[:, order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(pairs) != 0).any(axis=0)]))
    if len(first) != sequence.max() + 1:
        raise ValueError("a sequence belongs to two recordings")
    samples = np.diff(np.append(first, len(values)))
    means = np.add.reduceat(values[order].astype(np.float64), first) / samples
    return ClusteredValues(means, np.bincount(pairs[0, first]), tuple(map(str, units)))


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
        beyond = _unseen_share(data)
        return data.estimate((0.0, beyond) if data.mean < 0.5 else (1 - beyond, 1.0), EQUAL_RATES_INTERVAL)
    return data.estimate(rate_bounds(data.totals, data.sizes), RATE_INTERVAL)


def _unseen_share(data: ClusteredValues) -> float:
    """Return the largest share of units of a kind that none of these is of (Clopper's and Pearson's bound)."""
    return 1 - ((1 - CONFIDENCE) / 2) ** (1 / len(data.sizes))


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
        nonnegative: The quantity cannot fall below 0, so its interval does not either.
    """
    data = clustered(values, recording_ids, sequence_ids)
    # Equal values do not show their spread.
    bounds = (np.nan, np.nan)
    if not data.all_equal:
        bounds = mean_bounds(data.totals, data.sizes, data.variance, nonnegative=nonnegative)
    return data.estimate(bounds, MEAN_INTERVAL)


def difference_interval(
    first: Float[np.ndarray, " rows"], second: Float[np.ndarray, " rows"], recording_ids: Ids, *, rate: bool
) -> Estimate:
    """Mean of first - second over sequences, with an interval; both methods on the same sequences.

    Args:
        first: One a sequence.
        second: One a sequence.
        recording_ids: The unit of each sequence.
        rate: The values are rates, from 0 to 1.
    """
    return _tested(PairedValues(first, second, recording_ids, rate))[0]


def _tested(pair: PairedValues) -> tuple[Estimate, float | None]:
    """Return the difference of a pair with its interval, and the p-value of the test that the interval inverts."""
    data = clustered(pair.first - pair.second, pair.recording_ids)
    if len(data.sizes) < units_needed(1):
        # Not even differences of one sign in all units would be beyond chance.
        bounds = mean_bounds(data.totals, data.sizes, data.variance)
        method = MEAN_INTERVAL
        p_value = None
    else:
        means = flipped_means(data.totals, data.sizes, flips(data.units))
        bounds = flip_bounds(means)
        method = DIFFERENCE_INTERVAL
        p_value = float(flip_test(means))
    low, high = bounds
    # Units that all agree show no spread.
    if high - low <= EQUAL_WITHIN or data.all_equal:
        beyond = _unseen_share(data)
        bounds = (low - beyond * (1 + low), high + beyond * (1 - high)) if pair.rate else (np.nan, np.nan)
        method = EQUAL_RATES_INTERVAL
    if pair.rate:
        bounds = np.clip(bounds, -1.0, 1.0)
    return data.estimate(tuple(bounds), method), p_value


Conclusion = Literal["higher", "lower", "not supported by the data", "cannot be tested"]


@dataclass(frozen=True, eq=False)
class PairedValues:
    """One metric of two methods on the same sequences; each value the mean over the samples of a sequence.

    Attributes:
        recording_ids: The unit of each sequence: its recording, or its participant where these are tested in folds.
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
        needed: Units below which no difference can be found among so many comparisons.
    """

    difference: Estimate
    p_value: float | None
    adjusted_p_value: float | None
    detectable: float | None
    needed: int

    @property
    def conclusion(self) -> Conclusion:
        """Words for the result: is the first method higher or lower than the second at a family-wise 5 %?"""
        if self.adjusted_p_value is None or self.difference.n_recordings < self.needed:
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
    tested = [_tested(pair) for pair in pairs.values()]
    adjusted = holm([p_value for _, p_value in tested])
    family = max(sum(p_value is not None for _, p_value in tested), 1)
    found = {}
    for (name, pair), (difference, p_value), adjusted_p_value in zip(pairs.items(), tested, adjusted, strict=True):
        rows = pair.first - pair.second
        detectable = smallest_detectable(rows, pair.recording_ids, comparisons=family, rate=pair.rate)
        found[name] = Comparison(difference, p_value, adjusted_p_value, detectable, units_needed(family))
    return found


def smallest_detectable(
    values: Float[np.ndarray, " rows"],
    recording_ids: Ids,
    sequence_ids: Ids | None = None,
    *,
    comparisons: int,
    rate: bool = False,
) -> float | None:
    """Smallest difference that would be found with 80 % power at Holm's first step, from the spread between units.

    Args:
        values: Differences of two methods, of which only the spread counts. Those of one method stand for
            differences to an unrelated one of the same spread after multiplication by √2.
        recording_ids: One a row.
        sequence_ids: See :func:`clustered`.
        comparisons: Number of comparisons made together.
        rate: The values are differences of rates.

    Returns:
        In the unit of the differences; None where nothing can be found or the values are equal.
    """
    data = clustered(values, recording_ids, sequence_ids)
    if data.all_equal:
        return None
    found = detectable_difference(data.totals, data.sizes, data.variance, comparisons=comparisons, rate=rate)
    return found if np.isfinite(found) else None


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's step-down correction; comparisons without a p-value are no part of the family."""
    present = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, i) in enumerate(present):
        largest = max(largest, min(1.0, p * (len(present) - rank)))
        adjusted[i] = largest
    return adjusted
