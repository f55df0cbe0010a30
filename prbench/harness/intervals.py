"""Confidence intervals and comparisons that know that sequences of one recording are not independent.

Source: docs/specification/protocol.md#intervals. The formulas stand in :mod:`prbench.harness.clusters`.

Every estimate is the mean over sequences (of the mean over samples, where a sequence has several). Its units are
recordings, or whatever a caller names as independent, such as participants.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Float, Int

from prbench.harness import clusters
from prbench.harness.clusters import CONFIDENCE, EQUAL_WITHIN, SIGNIFICANCE, PerSet
from prbench.metrics import MetricInfo

Name = TypeVar("Name", bound=Hashable)
# One name a row.
Ids = Sequence[str] | np.ndarray
_MANY_RECORDINGS = 10
_FLIPPED_TOGETHER = 64  # differences, which take 32 MB


@dataclass(frozen=True)
class Estimate:
    """A mean over sequences with its 95 % interval.

    Attributes:
        mean: The mean.
        low: None where the data do not support an interval.
        high: Upper bound of the interval.
        n_sequences: Number of sequences.
        n_recordings: Number of units that they come from.
        method: Name of the interval, such as ``sign-flip``; ``none`` without one.
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
        totals: Sum of the values of each unit.
        units: Name of each unit.
        rate: Values are rates, from 0 to 1, or differences of rates.
    """

    values: Float[np.ndarray, " sequences"]
    sizes: Int[np.ndarray, " units"]
    totals: Float[np.ndarray, " units"]
    units: tuple[str, ...]
    rate: bool

    @property
    def all_equal(self) -> bool:
        """True if the values show no spread."""
        return bool(np.ptp(self.values) <= EQUAL_WITHIN)

    @property
    def variance(self) -> float:
        """Variance between all sequences, whatever their units; 0 of a single one."""
        return float(self.values.var(ddof=1)) if len(self.values) > 1 else 0.0

    def estimate(self, low: PerSet | float, high: PerSet | float, method: str) -> Estimate:
        """Put the mean and an interval of it together; bounds that are no numbers are none."""
        count = len(self.sizes)
        found = {"one_recording": count == 1, "few_recordings": count < _MANY_RECORDINGS, "all_equal": self.all_equal}
        marks = tuple(mark for mark, holds in found.items() if holds)
        mean = float(self.totals.sum() / self.sizes.sum())
        if np.isnan(low):
            return Estimate(mean, None, None, len(self.values), count, "none", marks)
        return Estimate(mean, float(low), float(high), len(self.values), count, method, marks)

    @property
    def unseen(self) -> float:
        """Largest share of units of a kind that none of these is of (Clopper's and Pearson's bound)."""
        return 1 - ((1 - CONFIDENCE) / 2) ** (1 / len(self.sizes))

    def detectable(self, comparisons: int) -> float | None:
        """Return the smallest difference that would be found with 80 % power at Holm's first step.

        The values are differences of two methods, of which only the spread counts. Those of one method stand for
        differences to an unrelated one of the same spread after multiplication by √2.

        Args:
            comparisons: Number of comparisons made together.

        Returns:
            In the unit of the differences; None where nothing can be found or the values are equal.
        """
        if self.all_equal or len(self.sizes) < clusters.units_needed(comparisons):
            return None
        about = {"comparisons": comparisons, "rate": self.rate}
        return clusters.detectable_difference(self.totals, self.sizes, self.variance, **about)


def clustered(
    values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None, *, rate: bool = False
) -> ClusteredValues:
    """Group values by sequence and unit.

    Args:
        values: One a row.
        recording_ids: The unit of each row: its recording, or its participant where these are tested in folds.
        sequence_ids: The sequence of each row, where a sequence has several samples; by default every row is one.
        rate: Values are rates, from 0 to 1, or differences of rates.

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
    means = np.add.reduceat(values[order].astype(np.float64), first) / np.diff(np.append(first, len(values)))
    sizes = np.bincount(pairs[0, first])
    totals = np.add.reduceat(means, np.cumsum(sizes) - sizes)
    return ClusteredValues(means, sizes, totals, tuple(map(str, units)), rate)


def metric_interval(
    info: MetricInfo, values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None
) -> Estimate:
    """Return the interval that fits a metric; arguments as those of :func:`clustered`."""
    data = clustered(values, recording_ids, sequence_ids)
    return rate_interval(data) if info.unit == "rate" else mean_interval(data, nonnegative=not info.can_be_negative)


def rate_interval(data: ClusteredValues) -> Estimate:
    """Return a rate (values from 0 to 1) over sequences, with its interval."""
    if data.values.min() < 0 or data.values.max() > 1:
        raise ValueError("a rate has values from 0 to 1")
    # All values are equal: their spread says nothing about how alike sequences of one recording are.
    if data.values.max() <= EQUAL_WITHIN:
        return data.estimate(0.0, data.unseen, "clopper-pearson-recordings")
    if data.values.min() >= 1 - EQUAL_WITHIN:
        return data.estimate(1 - data.unseen, 1.0, "clopper-pearson-recordings")
    return data.estimate(*clusters.rate_bounds(data.totals, data.sizes), "clopper-pearson-cluster")


def mean_interval(data: ClusteredValues, *, nonnegative: bool = False) -> Estimate:
    """Return a mean over sequences, with an interval from the spread between units.

    Args:
        data: The values.
        nonnegative: The quantity cannot fall below 0, so its interval does not either.
    """
    low, high = clusters.mean_bounds(data.totals, data.sizes, data.variance, nonnegative=nonnegative)
    # Equal values do not show their spread.
    return data.estimate(np.nan if data.all_equal else low, high, "student-cr2")


Conclusion = Literal["higher", "lower", "not supported by the data", "cannot be tested"]


@dataclass(frozen=True)
class Comparison:
    """The difference first - second, and whether the data support one.

    Attributes:
        difference: Mean difference over sequences with its interval.
        p_value: Two-sided; None below six units, where no difference could be found.
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


def compare(differences: Mapping[Name, ClusteredValues]) -> dict[Name, Comparison]:
    """Say which differences of two methods the data support, corrected for their number.

    Args:
        differences: Differences of pairs of methods, or of one pair on several metrics or datasets, by any name or key.
    """
    return compare_families({"": differences})[""]


def compare_families(families: Mapping[str, Mapping[Name, ClusteredValues]]) -> dict[str, dict[Name, Comparison]]:
    """Return what :func:`compare` does of each of several families, whose differences are flipped together."""
    everything = {(key, name): data for key, differences in families.items() for name, data in differences.items()}
    tested = _difference_intervals(everything)
    found = {}
    for key, differences in families.items():
        adjusted = holm([tested[key, name][1] for name in differences])
        family = sum(p_value is not None for p_value in adjusted) or len(differences)
        needed = clusters.units_needed(family) if differences else 0
        found[key] = {
            name: Comparison(*tested[key, name], adjusted_p_value, data.detectable(family), needed)
            for (name, data), adjusted_p_value in zip(differences.items(), adjusted, strict=True)
        }
    return found


def difference_interval(data: ClusteredValues) -> tuple[Estimate, float | None]:
    """Return a mean difference with its interval, and the p-value of the test that the interval inverts.

    Below six units, where not even differences of one sign would be beyond chance, there is no p-value, and the
    interval is that of a mean.
    """
    return _difference_intervals({"": data})[""]


def _difference_intervals(differences: Mapping[Name, ClusteredValues]) -> dict[Name, tuple[Estimate, float | None]]:
    """Return what :func:`difference_interval` does of each; those of the same units are flipped together."""
    alike: dict[tuple, list[Name]] = defaultdict(list)
    for name, data in differences.items():
        alike[data.units, tuple(data.sizes.tolist())].append(name)
    found: dict[Name, tuple[Estimate, float | None]] = {}
    for (units, sizes), names in alike.items():
        for start in range(0, len(names), _FLIPPED_TOGETHER):
            some = names[start : start + _FLIPPED_TOGETHER]
            totals = np.array([differences[name].totals for name in some])
            if len(units) < clusters.units_needed(1):
                for name in some:
                    data = differences[name]
                    bounds = clusters.mean_bounds(data.totals, data.sizes, data.variance)
                    found[name] = _estimated(data, *bounds, "student-cr2"), None
                continue
            means = clusters.flipped_means(totals, np.array(sizes), clusters.flips(units))
            tests = map(np.atleast_1d, (*clusters.flip_bounds(means), clusters.flip_test(means)))
            for name, low, high, p_value in zip(some, *tests, strict=True):
                found[name] = _estimated(differences[name], low, high, "sign-flip"), float(p_value)
    return {name: found[name] for name in differences}


def _estimated(data: ClusteredValues, low: PerSet, high: PerSet, method: str) -> Estimate:
    # Units that all agree show no spread, but those that were not seen may differ.
    if data.all_equal or high - low <= EQUAL_WITHIN:
        mean = data.totals.sum() / data.sizes.sum()
        reach = data.unseen if data.rate else np.nan
        low = mean - reach * (1 + mean)
        high = mean + reach * (1 - mean)
        method = "clopper-pearson-recordings"
    if data.rate:
        low = np.maximum(low, -1.0)
        high = np.minimum(high, 1.0)
    return data.estimate(low, high, method)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's step-down correction; comparisons without a p-value are no part of the family."""
    present = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, i) in enumerate(present):
        largest = max(largest, min(1.0, p * (len(present) - rank)))
        adjusted[i] = largest
    return adjusted
