"""Batches for a training loop, and how long the loop waited for them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from torch.utils.data import DataLoader

from prbench.errors import UsageError
from prbench.training.dataset import SequenceDataset
from prbench.training.items import MotionBatch, collate
from prbench.training.sampling import LengthBatches

Item = TypeVar("Item")

_AHEAD = 4  # batches that each worker prepares in advance


def load_batches(
    dataset: SequenceDataset, batches: LengthBatches, *, workers: int = 0, pinned: bool = False
) -> Iterator[MotionBatch]:
    """The batches that a sampler plans, made into tensors; without end, the same ones for any number of workers.

    Args:
        dataset: Where the items come from. Workers open its memory-mapped files again; nothing is copied to them.
        batches: Which items each batch holds.
        workers: Processes that prepare batches in advance; with 0 they are made when asked for. A batch of whole rows
            takes milliseconds, so workers pay for random crops of long clips and for steps of a few milliseconds.
        pinned: Put batches into page-locked memory, for a GPU.

    Raises:
        UsageError: if ``workers`` is negative.
    """
    if workers < 0:
        raise UsageError(f"workers is {workers}; give 0 or more.")
    loader = DataLoader(
        dataset,
        batch_sampler=batches,  # pyright: ignore[reportArgumentType]  # items are drawn by (index, epoch)
        collate_fn=collate,
        num_workers=workers,
        pin_memory=pinned,
        multiprocessing_context="spawn" if workers else None,
        prefetch_factor=_AHEAD if workers else None,
    )
    return iter(loader)


@dataclass
class WaitingClock:
    """Measures how much of a loop's time goes into waiting for data.

    >>> clock = WaitingClock()
    >>> sum(clock.timed([1, 2, 3]))
    6
    >>> 0.0 <= clock.fraction <= 1.0
    True
    """

    waited: float = 0.0
    """Seconds spent inside the source of the batches."""
    worked: float = 0.0
    """Seconds between two batches, spent by the loop itself."""

    @property
    def fraction(self) -> float:
        """Share of the time that was spent waiting; 0 before the first batch."""
        total = self.waited + self.worked
        return self.waited / total if total else 0.0

    def timed(self, source: Iterable[Item]) -> Iterator[Item]:
        """The items of a source, with the clock running; synchronise a GPU before asking for the next one."""
        iterator = iter(source)
        while True:
            asked = time.perf_counter()
            try:
                item = next(iterator)
            except StopIteration:
                return
            given = time.perf_counter()
            self.waited += given - asked
            yield item
            self.worked += time.perf_counter() - given
