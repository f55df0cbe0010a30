"""Differences of two methods, judged on the same sequences and recording by recording.

Source: docs/specification/protocol.md#comparisons.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.harness.clusters import SIGNIFICANCE, detectable_difference, p_values, power_of
from prbench.harness.intervals import EQUAL_WITHIN, Estimate, Ids, clustered, difference_interval

POWER = 0.8
"""Probability with which the smallest detectable difference would be found."""
POINTS = (5, 10, 20)
"""Differences of rates, in points, for which the probability of finding them is told."""

Conclusion = Literal["higher", "lower", "not supported by the data", "cannot be tested"]


@dataclass(frozen=True, eq=False)
class PairedValues:
    """One metric of two methods on the same sequences; each value the mean over the samples of a sequence."""

    first: Float[np.ndarray, " sequences"]
    second: Float[np.ndarray, " as_many"]
    recording_ids: Ids
    rate: bool = False
    """The values are rates, from 0 to 1."""


@dataclass(frozen=True)
class Comparison:
    """The difference first - second, and whether the data support one."""

    difference: Estimate
    """Mean difference over sequences with its interval."""
    p_value: float | None
    """Two-sided; None where it cannot be tested."""
    adjusted_p_value: float | None
    """After Holm's correction for all comparisons made together."""
    detectable: float | None = None
    """Smallest difference that is found with 80 % power at Holm's first step; None where none can be."""
    power: tuple[float, ...] = ()
    """Probability that true differences of :data:`POINTS` would be found at Holm's first step; empty but for rates."""

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
            power=_power_at_points(pair, comparisons=family) if pair.rate else (),
        )
    return found


def _power_at_points(pair: PairedValues, *, comparisons: int) -> tuple[float, ...]:
    data = clustered(pair.first - pair.second, pair.recording_ids)
    if "all_equal" in data.marks:
        return ()
    found = [float(power_of(data.spread, points / 100, comparisons=comparisons)) for points in POINTS]
    return () if np.isnan(found).any() else tuple(found)


def smallest_detectable(
    differences: Float[np.ndarray, " sequences"], recording_ids: Ids, *, comparisons: int
) -> float | None:
    """Smallest difference that would be found with 80 % power at Holm's first step, from the recordings' spread.

    Args:
        differences: Of two methods, one a sequence; only their spread counts.
        recording_ids: One a sequence.
        comparisons: Number of comparisons made together.

    Returns:
        In the unit of the differences; None where nothing can be tested or the values are equal.
    """
    data = clustered(differences, recording_ids)
    if "all_equal" in data.marks:
        return None
    found = float(detectable_difference(data.spread, comparisons=comparisons, power=POWER))
    return None if np.isnan(found) else found


def smallest_detectable_unpaired(
    values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids, *, comparisons: int
) -> float | None:
    """Like :func:`smallest_detectable`, for the difference to an unrelated method of the same spread as this one.

    Args:
        values: Of one method, one a row.
        recording_ids: One a row.
        sequence_ids: One a row; a sequence with several samples has several rows.
        comparisons: Number of comparisons made together.
    """
    data = clustered(values, recording_ids, sequence_ids)
    if "all_equal" in data.marks:
        return None
    found = np.sqrt(2) * float(detectable_difference(data.spread, comparisons=comparisons, power=POWER))
    return None if np.isnan(found) else float(found)


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
