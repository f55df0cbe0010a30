"""Means over datasets and their intervals."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from prbench.harness.run_folder.summary import MetricSummary, bounds_of_mean, mean_over_datasets
from tests.harness.run_folder.test_record import METRIC


def metric(mean: float, low: float | None, high: float | None) -> MetricSummary:
    return replace(METRIC, mean=mean, low=low, high=high)


def test_the_mean_of_one_dataset_has_its_own_interval():
    found = mean_over_datasets([metric(0.3, 0.1, 0.6)])
    assert found is not None
    assert (found.mean, found.low, found.high) == pytest.approx((0.3, 0.1, 0.6))


def test_independent_errors_are_added_as_squares_to_either_side():
    found = mean_over_datasets([metric(0.5, 0.2, 0.6), metric(0.7, 0.3, 0.7)])
    assert found is not None
    # down: sqrt(0.3² + 0.4²) / 2; up: sqrt(0.1² + 0) / 2
    assert (found.mean, found.low, found.high) == pytest.approx((0.6, 0.35, 0.65))


def test_equal_datasets_halve_the_width_as_four_times_the_data_do():
    low, high = bounds_of_mean(np.full(4, 0.5), np.full(4, 0.4), np.full(4, 0.6))
    assert (float(low), float(high)) == pytest.approx((0.45, 0.55))


def test_no_interval_without_one_of_every_dataset_and_no_mean_without_a_value_of_every_dataset():
    found = mean_over_datasets([metric(0.5, 0.2, 0.6), metric(0.7, None, None)])
    assert found is not None
    assert (found.mean, found.low, found.high) == (pytest.approx(0.6), None, None)
    assert mean_over_datasets([metric(0.5, 0.2, 0.6), None]) is None


def test_means_of_rates_stay_between_0_and_1():
    low, high = bounds_of_mean(np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.5, 0.6]), np.array([0.5, 1.0, 1.0]))
    assert 0 <= low <= 2 / 3 <= high <= 1
