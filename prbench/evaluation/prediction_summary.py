"""Scores of motion prediction with intervals over recordings, and paired differences of two predictors or conditions.

Source: docs/specification/motion-prediction.md#metrics. Windows overlap, so recordings are the clusters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.errors import UsageError
from prbench.evaluation.comparisons import paired_p_value
from prbench.evaluation.intervals import Estimate, mean_interval
from prbench.prediction.scoring import Scores


def summarise(scores: Scores) -> dict[str, Estimate]:
    """Mean over windows of every score, with its interval; scores that no window has are left out."""
    recordings = np.array(scores.columns["recording_id"])
    found = {}
    for name, values in scores.metrics.items():
        known = np.isfinite(values)
        if known.any():
            found[name] = mean_interval(values[known], recordings[known])
    return found


@dataclass(frozen=True)
class Difference:
    """How much one score of a predictor differs from that of another on the same windows."""

    estimate: Estimate
    """Second minus first; below zero where less is better and the second is better."""
    p_value: float | None
    """None where there are too few recordings."""


def differences(first: Scores, second: Scores) -> dict[str, Difference]:
    """Paired differences of every score that both have, for example ``pose+gaze`` against ``pose``.

    Args:
        first: Scores of some windows.
        second: Scores of the same windows.

    Raises:
        UsageError: if they are of different windows.
    """
    if first.columns["window_id"] != second.columns["window_id"]:
        raise UsageError(
            f"expected scores of the same windows, found {len(first.columns['window_id'])} and"
            f" {len(second.columns['window_id'])} that differ. Score both on one choice of one table."
        )
    recordings = np.array(first.columns["recording_id"])
    found = {}
    for name, values in first.metrics.items():
        if name not in second.metrics:
            continue
        apart = second.metrics[name] - values
        known = np.isfinite(apart)
        if known.any():
            p_value = paired_p_value(apart[known], recordings[known])
            found[name] = Difference(mean_interval(apart[known], recordings[known]), p_value)
    return found
