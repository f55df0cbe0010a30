"""Differences of two methods, judged on the same sequences and recording by recording.

Source: docs/specification/protocol.md#comparisons.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.evaluation.intervals import EQUAL_WITHIN, Estimate, Ids, clustered, mean_interval
from prbench.randomness import named_generator

_FEWEST_FOR_P_VALUE = 6
"""Recordings: with five, the smallest two-sided p-value of a sign-flip test is 2/32, above 5 %."""
LARGEST_ENUMERATION = 36
"""Recordings up to which all sign patterns are counted; beyond, random ones."""
_PERMUTATIONS = 100_000
_PATTERNS_AT_ONCE = 10_000
_SIGNIFICANCE = 0.05

Conclusion = Literal["higher", "lower", "not supported by the data"]


@dataclass(frozen=True, eq=False)
class PairedValues:
    """One metric of two methods on the same sequences; each value the mean over the samples of a sequence."""

    first: Float[np.ndarray, " sequences"]
    second: Float[np.ndarray, " as_many"]
    recording_ids: Ids


@dataclass(frozen=True)
class Comparison:
    """The difference first - second, and whether the data support one."""

    difference: Estimate
    p_value: float | None
    """Two-sided; None below six recordings."""
    adjusted_p_value: float | None
    """After Holm's correction for all comparisons made together."""

    @property
    def conclusion(self) -> Conclusion:
        """Words for the result: is the first method higher or lower than the second at a family-wise 5 %?"""
        if self.adjusted_p_value is None or self.adjusted_p_value > _SIGNIFICANCE:
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
    differences = [pair.first - pair.second for pair in pairs.values()]
    recordings = [pair.recording_ids for pair in pairs.values()]
    p_values = [sign_flip_p_value(difference, ids) for difference, ids in zip(differences, recordings, strict=True)]
    found = zip(pairs, differences, recordings, p_values, holm(p_values), strict=True)
    return {name: Comparison(mean_interval(difference, ids), p, q) for name, difference, ids, p, q in found}


def sign_flip_p_value(differences: Float[np.ndarray, " sequences"], recording_ids: Ids) -> float | None:
    """Two-sided p-value of the mean difference, if the sign of each recording's differences were a coin's.

    All sign patterns are counted up to 36 recordings, otherwise 100,000 random ones, which depend on the names of the
    recordings alone. Mean differences that agree within 10 µm (or as little of another unit) are ties.

    Returns:
        None below six recordings, where no result could be significant.
    """
    data = clustered(differences, recording_ids)
    totals = data.totals
    if len(totals) < _FEWEST_FOR_P_VALUE:
        return None
    # The tolerance makes ties of differences that rounding alone tells apart.
    reached = abs(float(totals.sum())) - EQUAL_WITHIN * len(data.samples)
    if reached <= 0:
        return 1.0
    if len(totals) <= LARGEST_ENUMERATION:
        return _patterns_that_reach(reached, totals) / 2 ** len(totals)
    # One is added to both: the observed pattern is itself one of the draws, so p is never 0.
    return (1 + _random_patterns_that_reach(reached, totals, data.recordings)) / (1 + _PERMUTATIONS)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's step-down correction; comparisons without a p-value are no part of the family."""
    present = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, i) in enumerate(present):
        largest = max(largest, min(1.0, p * (len(present) - rank)))
        adjusted[i] = largest
    return adjusted


def _patterns_that_reach(least: float, totals: Float[np.ndarray, " recordings"]) -> int:
    """Number of sign patterns whose sum has at least this absolute value, which is above 0.

    Every pattern is one of the first half of the recordings joined to one of the second half, so that the sums of the
    halves are all that has to be made: the pairs are counted among sorted numbers.
    """
    half = len(totals) // 2
    first = np.sort(_sums_of_all_signs(totals[:half]))
    second = np.sort(_sums_of_all_signs(totals[half:]))
    below = np.searchsorted(first, -least - second, side="right")
    not_above = np.searchsorted(first, least - second, side="left")
    return int(below.sum() + (len(first) - not_above).sum())


def _sums_of_all_signs(totals: Float[np.ndarray, " recordings"]) -> Float[np.ndarray, " patterns"]:
    sums = np.zeros(1)
    for total in totals:
        sums = np.concatenate([sums + total, sums - total])
    return sums


def _random_patterns_that_reach(
    least: float, totals: Float[np.ndarray, " recordings"], recordings: Sequence[str]
) -> int:
    generator = named_generator("sign-flips", *recordings)
    found = 0
    for _ in range(_PERMUTATIONS // _PATTERNS_AT_ONCE):
        signs = generator.choice(np.array([-1.0, 1.0]), size=(_PATTERNS_AT_ONCE, len(totals)))
        found += int((np.abs(signs @ totals) >= least).sum())
    return found
