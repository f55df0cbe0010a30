"""Means of scores with intervals over recordings, and pairs of scores to compare, by the estimators of runs.

Windows overlap, so recordings are the clusters (docs/specification/motion-prediction.md#metrics).
"""

from __future__ import annotations

import numpy as np

from prbench.errors import UsageError
from prbench.harness.intervals import Estimate, PairedValues, metric_interval
from prbench_benchmarks.motion_prediction.metric_infos import prediction_metrics
from prbench_benchmarks.motion_prediction.scoring import Scores


def estimates(scores: Scores) -> dict[str, Estimate]:
    """Return the mean over windows of every score with its interval; scores that no window has are left out."""
    recordings = np.array(scores.columns["recording_id"])
    found = {}
    for info in prediction_metrics():
        values = scores.metrics.get(info.id)
        if values is None:
            continue
        known = np.isfinite(values)
        if known.any():
            found[info.id] = metric_interval(info, values[known], recordings[known])
    return found


def paired(first: Scores, second: Scores) -> dict[str, PairedValues]:
    """Pair the scores that two predictors, or one under two conditions, both have, by metric.

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
    others = second.metrics
    found = {}
    for name, values in first.metrics.items():
        known = np.isfinite(values) & np.isfinite(others[name]) if name in others else np.zeros(len(values), dtype=bool)
        if known.any():
            found[name] = PairedValues(values[known], others[name][known], recordings[known])
    return found
