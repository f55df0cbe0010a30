"""Means over datasets, each counting alike as in the study, with their intervals.

Source: docs/specification/protocol.md#intervals ("Means over datasets").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.harness.run_folder.record import TableRecord
from prbench.harness.run_folder.summary import DatasetSummary, MetricSummary


@dataclass(frozen=True)
class MeanOverDatasets:
    """The mean of one metric over datasets; rates from 0 to 1."""

    mean: float
    """Mean over the datasets, each counting alike."""
    low: float | None
    """Lower bound of the 95 % interval; None where a dataset has no interval."""
    high: float | None
    """Upper bound of the interval."""


def share_a_mean(tables: Sequence[TableRecord]) -> bool:
    """Return False where one of several tables has bodies that were estimated from the head, and another has not."""
    return len({table.estimated_bodies for table in tables}) == 1


def means_over_datasets(summaries: Sequence[DatasetSummary]) -> dict[str, MeanOverDatasets]:
    """Return the mean of each metric over datasets.

    Args:
        summaries: Of one method, one a dataset.

    Returns:
        Means by metric id; without those that a dataset lacks, since a mean over the others would look like a better or
        worse method.
    """
    means = {}
    for name in dict.fromkeys(metric.metric for summary in summaries for metric in summary.metrics):
        mean = mean_over_datasets([summary.metric(name) for summary in summaries])
        if mean is not None:
            means[name] = mean
    return means


def mean_over_datasets(metrics: Sequence[MetricSummary | None]) -> MeanOverDatasets | None:
    """Return the mean of one metric over datasets, or None if one of them lacks it.

    Args:
        metrics: Of one method, one a dataset.
    """
    values = np.array([metric.mean for metric in metrics if metric is not None])
    if len(values) < len(metrics):
        return None
    bounds = [(metric.low, metric.high) for metric in metrics if metric is not None]
    lows = [low for low, _ in bounds if low is not None]
    highs = [high for _, high in bounds if high is not None]
    if min(len(lows), len(highs)) < len(values):
        return MeanOverDatasets(float(values.mean()), None, None)
    low, high = bounds_of_mean(values, np.array(lows), np.array(highs))
    return MeanOverDatasets(float(values.mean()), float(low), float(high))


def intervals_of_means(means: Mapping[str, MeanOverDatasets]) -> dict[str, list[float]]:
    """Return the bounds of each mean that has an interval, as reports show them."""
    return {
        name: [mean.low, mean.high] for name, mean in means.items() if mean.low is not None and mean.high is not None
    }


def bounds_of_mean(
    means: Float[np.ndarray, "datasets *sets"],
    lows: Float[np.ndarray, "datasets *sets"],
    highs: Float[np.ndarray, "datasets *sets"],
) -> tuple[np.ndarray | np.floating, np.ndarray | np.floating]:
    """Return the 95 % interval of the mean over datasets from the intervals of the datasets.

    Their errors are independent, so the distances from mean to bound are added as squares, downwards and upwards by
    themselves ("square and add", Zou and Donner 2008). That keeps the intervals' skewness, and datasets at 0 % and
    100 % add the width that their intervals have.

    Args:
        means: Mean of each dataset.
        lows: Lower bounds of their intervals.
        highs: Upper bounds.

    Returns:
        Lower and upper bound, without the axis of datasets.
    """
    mean = means.mean(axis=0)
    down = np.sqrt(((means - lows) ** 2).sum(axis=0)) / len(means)
    up = np.sqrt(((highs - means) ** 2).sum(axis=0)) / len(means)
    return mean - down, mean + up
