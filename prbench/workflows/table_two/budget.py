"""How many sequences fit into a time: from what a first batch of every row has cost."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Int

RESERVE = 0.1
"""Share of the time that is left free: the last batch of all is made alone, and machines have other work."""
LARGEST_BATCH = 16
"""Sequences; as many as the slowest methods generate side by side."""
_SHARES = 2
"""Batches of equal size for as many workers; a fixed number, so that ``--workers`` changes no result."""


class RowCost(msgspec.Struct, frozen=True, kw_only=True):
    """What a first batch of one row has cost."""

    seconds_per_frame: float
    """Of ``generate``, in one worker while the others work, too; padding counts as frames."""
    overhead: float
    """Seconds of everything else for one dataset: loading, reading, scoring."""


@dataclass(frozen=True)
class DatasetSize:
    """As much of a table as an estimate needs."""

    n_frames: Int[np.ndarray, " sequences"]
    """Of the split, in the order in which a growing limit takes sequences up."""

    @property
    def sequences(self) -> int:
        """In the split."""
        return len(self.n_frames)


@dataclass(frozen=True)
class Pace:
    """How the work is spread."""

    batch_size: int | None
    """None for :func:`even_batch_size`."""
    workers: int
    samples: int


def even_batch_size(limit: int, sizes: Sequence[DatasetSize]) -> int:
    """The largest batches, up to :data:`LARGEST_BATCH`, that leave none of two workers without one."""
    most = max(min(limit, size.sequences) for size in sizes)
    rounds = math.ceil(most / (_SHARES * LARGEST_BATCH))
    return math.ceil(most / (_SHARES * rounds))


def table_seconds(costs: Collection[RowCost], limit: int, sizes: Sequence[DatasetSize], pace: Pace) -> float:
    """Seconds that all rows take on ``limit`` sequences of each dataset, batches of one row beside those of others."""
    batch_size = pace.batch_size or even_batch_size(limit, sizes)
    batches = [frames * pace.samples for size in sizes for frames in _padded_frames(size.n_frames[:limit], batch_size)]
    frames, longest = sum(batches), max(batches)
    generating = sum(cost.seconds_per_frame for cost in costs) * frames / pace.workers
    alone = max((cost.seconds_per_frame for cost in costs), default=0.0) * longest
    return max(generating, alone) + len(sizes) * sum(cost.overhead for cost in costs)


def _padded_frames(n_frames: Int[np.ndarray, " sequences"], batch_size: int) -> list[int]:
    """Of each batch; sequences of similar length go together."""
    ordered = np.sort(n_frames)
    batches = (ordered[i : i + batch_size] for i in range(0, len(ordered), batch_size))
    return [len(batch) * int(batch[-1]) for batch in batches]


def largest_limit(costs: Collection[RowCost], sizes: Sequence[DatasetSize], pace: Pace, *, seconds: float) -> int:
    """The most sequences of each dataset with which all rows fit into ``seconds``, a reserve kept; at least 1.

    Args:
        costs: Of the rows that will be run.
        sizes: Of the datasets.
        pace: How the work is spread.
        seconds: That are left.
    """
    low, high = 1, max(size.sequences for size in sizes)
    while low < high:
        middle = math.ceil((low + high) / 2)
        fits = table_seconds(costs, middle, sizes, pace) <= (1 - RESERVE) * seconds
        low, high = (middle, high) if fits else (low, middle - 1)
    return low
