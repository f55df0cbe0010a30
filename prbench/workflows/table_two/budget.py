"""How many sequences fit into a time: from what a first batch of every row has cost."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import msgspec

RESERVE = 0.1
"""Share of the time that is left free: two workers are a little slower than one that has the machine to itself."""


class RowCost(msgspec.Struct, frozen=True, kw_only=True):
    """What a first batch of one row has cost."""

    seconds_per_frame: float
    """Of ``generate``, in one worker."""
    overhead: float
    """Seconds of everything else: starting, loading, reading, scoring."""


@dataclass(frozen=True)
class DatasetSize:
    """As much of a table as an estimate needs."""

    sequences: int
    """In the split."""
    mean_frames: float


@dataclass(frozen=True)
class Pace:
    """How the work is spread."""

    batch_size: int
    workers: int
    samples: int


def row_seconds(cost: RowCost, limit: int, sizes: Sequence[DatasetSize], pace: Pace) -> float:
    """Seconds that a row takes on ``limit`` sequences of each dataset; a half-filled round counts as a whole one."""
    total = 0.0
    for size in sizes:
        chosen = min(limit, size.sequences)
        whole, rest = divmod(chosen, pace.batch_size)
        rounds, left = divmod(whole, pace.workers)
        last = pace.batch_size if left else rest
        motions = (rounds * pace.batch_size + last) * pace.samples
        total += cost.overhead + motions * size.mean_frames * cost.seconds_per_frame
    return total


def largest_limit(costs: Iterable[RowCost], sizes: Sequence[DatasetSize], pace: Pace, *, seconds: float) -> int:
    """The most sequences of each dataset with which all rows fit into ``seconds``, a reserve kept; at least 1.

    Args:
        costs: Of the rows that will be run.
        sizes: Of the datasets.
        pace: How the work is spread.
        seconds: That are left.
    """
    costs = list(costs)
    low, high = 1, max(size.sequences for size in sizes)
    while low < high:
        middle = math.ceil((low + high) / 2)
        fits = sum(row_seconds(cost, middle, sizes, pace) for cost in costs) <= (1 - RESERVE) * seconds
        low, high = (middle, high) if fits else (low, middle - 1)
    return low
