"""How many sequences fit into a time."""

from __future__ import annotations

import numpy as np
import pytest

from prbench_benchmarks.prime_and_reach.table_two.budget import (
    RESERVE,
    RowCost,
    Work,
    even_batch_size,
    largest_limit,
    table_seconds,
)

COST = RowCost(seconds_per_frame=0.01, overhead=5.0)
LENGTHS = [np.full(96, 100)]


def work(lengths=LENGTHS, *, batch_size: int | None = 12, workers: int = 2, samples: int = 1) -> Work:
    return Work(lengths, batch_size, workers, samples)


def test_a_table_costs_its_overheads_and_its_batches_spread_over_the_workers():
    assert table_seconds([COST], 24, work()) == 5 + 12 * 100 * 0.01
    assert table_seconds([COST], 24, work(workers=1)) == 5 + 24 * 100 * 0.01
    assert table_seconds([COST], 24, work(samples=3)) == 5 + 36 * 100 * 0.01
    assert table_seconds([COST, COST], 36, work()) == pytest.approx(10 + 36 * 100 * 0.01)


def test_one_batch_takes_its_time_however_many_workers_there_are():
    assert table_seconds([COST], 12, work(workers=4)) == 5 + 12 * 100 * 0.01
    assert table_seconds([COST, COST], 12, work()) == 10 + 12 * 100 * 0.01  # side by side


def test_padding_costs_too_and_little_of_it_where_lengths_are_alike():
    lengths = [np.array([60, 200, 60, 200])]
    assert table_seconds([COST], 4, work(lengths, batch_size=4, workers=1)) == 5 + 4 * 200 * 0.01
    assert table_seconds([COST], 4, work(lengths, batch_size=2, workers=1)) == 5 + (2 * 60 + 2 * 200) * 0.01
    assert table_seconds([COST], 2, work(lengths, batch_size=1, workers=1)) == 5 + (60 + 200) * 0.01  # the first two


def test_a_dataset_costs_no_more_than_it_has():
    lengths = [*LENGTHS, np.full(6, 200)]
    assert table_seconds([COST], 24, work(lengths, workers=1)) == pytest.approx(2 * 5 + (24 * 100 + 6 * 200) * 0.01)


@pytest.mark.parametrize("seconds", [60.0, 100.0, 300.0, 333.0])
@pytest.mark.parametrize("batch_size", [None, 12])
def test_the_limit_is_the_largest_that_fits(seconds, batch_size):
    costs = [COST, RowCost(seconds_per_frame=0.05, overhead=2.0)]

    def total(n: int) -> float:
        return table_seconds(costs, n, work(batch_size=batch_size))

    limit = largest_limit(costs, work(batch_size=batch_size), seconds=seconds)
    assert total(limit) <= (1 - RESERVE) * seconds
    assert limit == 96 or total(limit + 1) > (1 - RESERVE) * seconds
    assert limit > 1


def test_it_is_one_at_least_and_never_more_than_there_are():
    assert largest_limit([COST], work(), seconds=0.0) == 1
    assert largest_limit([COST], work(), seconds=1e9) == 96
    assert largest_limit([], work(), seconds=1.0) == 96


@pytest.mark.parametrize(
    ("limit", "size"), [(1, 1), (2, 1), (11, 6), (24, 12), (32, 16), (33, 9), (64, 16), (96, 16), (10_000, 16)]
)
def test_two_workers_have_as_many_batches_of_equal_size(limit, size):
    assert even_batch_size(limit, LENGTHS) == size
    assert even_batch_size(limit, [*LENGTHS, np.full(3, 100)]) == size
