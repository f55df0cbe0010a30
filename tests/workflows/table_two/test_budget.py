"""How many sequences fit into a time."""

from __future__ import annotations

import pytest

from prbench.workflows.table_two.budget import RESERVE, DatasetSize, Pace, RowCost, largest_limit, row_seconds

COST = RowCost(seconds_per_frame=0.01, overhead=5.0)
SIZES = [DatasetSize(sequences=96, mean_frames=100.0)]


def pace(batch_size: int = 12, workers: int = 2, samples: int = 1) -> Pace:
    return Pace(batch_size, workers, samples)


def test_a_row_costs_its_overhead_and_the_busiest_workers_batches():
    assert row_seconds(COST, 12, SIZES, pace()) == 5 + 12 * 100 * 0.01  # one batch: the other worker idles
    assert row_seconds(COST, 24, SIZES, pace()) == 5 + 12 * 100 * 0.01
    assert row_seconds(COST, 25, SIZES, pace()) == 5 + 13 * 100 * 0.01
    assert row_seconds(COST, 36, SIZES, pace()) == 5 + 24 * 100 * 0.01
    assert row_seconds(COST, 36, SIZES, pace(workers=1)) == 5 + 36 * 100 * 0.01
    assert row_seconds(COST, 36, SIZES, pace(samples=3)) == 5 + 72 * 100 * 0.01


def test_a_dataset_costs_no_more_than_it_has():
    sizes = [*SIZES, DatasetSize(sequences=6, mean_frames=200.0)]
    assert row_seconds(COST, 24, sizes, pace()) == 2 * 5 + 12 + 6 * 200 * 0.01


@pytest.mark.parametrize("seconds", [60.0, 100.0, 300.0, 333.0])
def test_the_limit_is_the_largest_that_fits(seconds):
    costs = [COST, RowCost(seconds_per_frame=0.05, overhead=2.0)]
    limit = largest_limit(costs, SIZES, pace(), seconds=seconds)

    def total(n: int) -> float:
        return sum(row_seconds(cost, n, SIZES, pace()) for cost in costs)

    assert total(limit) <= (1 - RESERVE) * seconds
    assert limit == 96 or total(limit + 1) > (1 - RESERVE) * seconds
    assert limit > 1


def test_it_is_one_at_least_and_never_more_than_there_are():
    assert largest_limit([COST], SIZES, pace(), seconds=0.0) == 1
    assert largest_limit([COST], SIZES, pace(), seconds=1e9) == 96
    assert largest_limit([], SIZES, pace(), seconds=1.0) == 96
