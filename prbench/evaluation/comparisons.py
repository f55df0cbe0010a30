"""Whether two methods differ, judged on the same sequences and recording by recording (design, section 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.evaluation.intervals import ClusteredValues, Estimate, Ids, clustered, mean_interval, seed_of

FEWEST_FOR_P_VALUE = 6
"""Recordings: with five, the smallest two-sided p-value of a sign-flip test is 2/32, above 5 %."""
LARGEST_ENUMERATION = 16
"""Recordings up to which all sign patterns are tried; beyond, random ones."""
PERMUTATIONS = 20_000
SIGNIFICANCE = 0.05

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
        """Whether the first method is higher or lower than the second at a family-wise 5 %."""
        if self.adjusted_p_value is None or self.adjusted_p_value > SIGNIFICANCE:
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

    All sign patterns are tried up to 16 recordings, otherwise 20,000 random ones (the same for the same data).

    Returns:
        None below six recordings, where no result could be significant.
    """
    data = clustered(differences, recording_ids)
    if len(data.sequences) < FEWEST_FOR_P_VALUE:
        return None
    totals = data.totals
    tolerance = 1e-9 * np.abs(totals).sum()
    if len(totals) <= LARGEST_ENUMERATION:
        flipped = np.abs(_all_signs(len(totals)) @ totals)
        return float((flipped >= abs(totals.sum()) - tolerance).mean())
    flipped = np.abs(_random_signs(data) @ totals)
    return float((1 + (flipped >= abs(totals.sum()) - tolerance).sum()) / (1 + PERMUTATIONS))


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's step-down correction; comparisons without a p-value are no part of the family."""
    present = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, i) in enumerate(present):
        largest = max(largest, min(1.0, p * (len(present) - rank)))
        adjusted[i] = largest
    return adjusted


def _all_signs(count: int) -> Float[np.ndarray, "patterns count"]:
    return 1.0 - 2.0 * (np.arange(2**count)[:, None] >> np.arange(count) & 1)


def _random_signs(data: ClusteredValues) -> Float[np.ndarray, "patterns count"]:
    generator = np.random.default_rng(seed_of(data))
    return generator.choice([-1.0, 1.0], size=(PERMUTATIONS, len(data.sequences)))
