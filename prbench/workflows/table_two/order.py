"""The order of a block's methods by Prime Success, and whether the data support each step of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from prbench.evaluation.comparisons import Comparison, compare
from prbench.leaderboard.comparison import paired_scores
from prbench.runs.folder import RunFolder

METRIC = "prime_success"
"""The study's first metric, and what the benchmark is about."""


@dataclass(frozen=True)
class Step:
    """The step from one method to the next worse one; points of Prime Success."""

    better: str
    """Name of the line."""
    worse: str
    difference: float
    low: float | None
    high: float | None
    p: float | None
    """p-value of sign flips by recording, after Holm's correction for the steps of the block."""
    supported: bool


def order_of(means: Mapping[str, float], folders: Mapping[str, Path], dataset: str) -> tuple[Step, ...]:
    """Compare each method of a block with the next worse one, sequence by sequence.

    Args:
        means: Prime Success by line; lines with the same number keep their order.
        folders: Run folders of these lines, all scored on the same sequences.
        dataset: Of the runs.

    Raises:
        RunError: if runs are damaged or do not belong together.
    """
    ordered = sorted(means, key=lambda name: -means[name])
    runs = {name: RunFolder.open(folders[name]) for name in ordered}
    pairs = {
        (better, worse): paired_scores(runs[better], runs[worse], dataset)[f"{dataset}\n{METRIC}"]
        for better, worse in pairwise(ordered)
    }
    found = compare({"\n".join(names): pair for names, pair in pairs.items()})
    return tuple(_step(names, comparison) for names, comparison in zip(pairs, found.values(), strict=True))


def _step(names: Sequence[str], comparison: Comparison) -> Step:
    better, worse = names
    estimate = comparison.difference
    bounds = (estimate.low, estimate.high)
    if "all_equal" in estimate.marks:
        bounds = (None, None)  # a bootstrap of equal differences would claim certainty
    low, high = (None if bound is None else 100 * bound for bound in bounds)
    supported = comparison.conclusion == "higher"
    return Step(better, worse, 100 * estimate.mean, low, high, comparison.adjusted_p_value, supported)
