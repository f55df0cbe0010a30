"""Endless batches of similar length, whose order is a function of seed and step, and a clock for waiting times."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Int
from torch.utils.data import DataLoader

from prbench.errors import UsageError
from prbench.randomness import named_generator
from prbench_adapters.training.dataset import SequenceDataset
from prbench_adapters.training.items import MotionBatch
from prbench_adapters.training.windows import WindowBatch, WindowsDataset

Draw = tuple[int, int]
"""Index of an item, and the epoch that it is drawn for."""
_POOL = 32
"""Batches that are sorted by length together: enough for little padding, few enough that batches stay random."""
Item = TypeVar("Item")
_AHEAD = 4  # batches that each worker prepares in advance


class LengthBatches:
    """Chooses the items of each batch: a batch sampler for a DataLoader, without end.

    Every epoch shows the items in a new order. Within a window of that order the items of similar length come together,
    then the batches change places. What step s shows depends on ``(seed, s, rank, world_size)`` and nothing else, so a
    run goes on anywhere with ``start_step``. The processes of one run share the batches of a step: none of them sees an
    item of another in that epoch. Items that fill no whole batch are left to the next epochs.

    Args:
        dataset: Its lengths decide; a set with fewer items than one step needs is shown several times over.
        batch_size: Items that each process gets at a step, or with ``unit="frames"`` the most frames, padding included.
        seed: Of the order.
        rank: Which of the processes this is, from 0.
        world_size: How many processes train together.
        start_step: The first step that is shown.
        unit: What ``batch_size`` counts.

    Raises:
        UsageError: if a number is out of range, or not even one of the longest items fits into a batch.
    """

    def __init__(
        self,
        dataset: SequenceDataset | WindowsDataset,
        batch_size: int,
        seed: int = 0,
        rank: int = 0,
        world_size: int = 1,
        start_step: int = 0,
        *,
        unit: Literal["sequences", "frames"] = "sequences",
    ) -> None:
        if batch_size < 1 or not 0 <= rank < world_size or start_step < 0:
            raise UsageError(
                f"batch_size {batch_size}, rank {rank} of {world_size} and start_step {start_step} do not fit together."
            )
        self._lengths = dataset.lengths
        if unit == "frames" and batch_size < self._lengths.max():
            raise UsageError(
                f"a batch of {batch_size} frames does not hold the longest item ({self._lengths.max()} frames)."
                " Raise batch_size, or lower max_frames."
            )
        self._batch_size, self._unit = batch_size, unit
        self._seed, self._rank, self._world_size, self._start_step = seed, rank, world_size, start_step

    def __iter__(self) -> Iterator[list[Draw]]:
        """The batches of this process from ``start_step`` on, without end."""
        epoch, skipped = self._beginning()
        while True:
            for batch in self._epoch(epoch)[skipped:]:
                yield [(int(index), int(turn)) for index, turn in batch[self._rank :: self._world_size]]
            epoch = epoch + 1
            skipped = 0

    def _beginning(self) -> tuple[int, int]:
        """The epoch that ``start_step`` lies in, and the batches of it that come before."""
        if self._unit == "sequences":
            together = self._batch_size * self._world_size
            return divmod(self._start_step, max(len(self._lengths) // together, 1))
        epoch = 0
        left = self._start_step
        while left >= (count := len(self._epoch(epoch))):
            epoch = epoch + 1
            left = left - count
        return epoch, left

    def _epoch(self, epoch: int) -> list[Int[np.ndarray, "items 2"]]:
        """All batches of one epoch for all processes together: rows of (index, epoch of the draw)."""
        generator = named_generator("prbench-training-order", self._seed, epoch)
        needed = self._world_size * (self._batch_size if self._unit == "sequences" else 1)
        turns = max(-(-needed // len(self._lengths)), 1)
        order = np.concatenate([generator.permutation(len(self._lengths)) for _ in range(turns)])
        turn = np.repeat(np.arange(epoch * turns, (epoch + 1) * turns), len(self._lengths))
        # A small set is shown several times over; each turn draws other crops and captions.
        draws = np.column_stack([order, turn])
        batches = self._of_sequences(draws) if self._unit == "sequences" else self._of_frames(draws)
        return [batches[place] for place in generator.permutation(len(batches))]

    def _of_sequences(self, draws: np.ndarray) -> list[np.ndarray]:
        together = self._batch_size * self._world_size
        whole = draws[: len(draws) // together * together]
        pools = (
            self._sorted(whole[start : start + _POOL * together]) for start in range(0, len(whole), _POOL * together)
        )
        return [pool[start : start + together] for pool in pools for start in range(0, len(pool), together)]

    def _of_frames(self, draws: np.ndarray) -> list[np.ndarray]:
        """Batches of as many items as fit: at most ``batch_size`` frames for each process, padding included."""
        batches = []
        pool_items = int(_POOL * self._world_size * max(self._batch_size // self._lengths.mean(), 1))
        for start in range(0, len(draws), pool_items):
            pool = self._sorted(draws[start : start + pool_items])[::-1]  # longest first: the first decides the padding
            while len(pool):
                items = self._batch_size // int(self._lengths[pool[0, 0]]) * self._world_size
                if len(pool) >= self._world_size:
                    batches.append(pool[: min(items, len(pool) // self._world_size * self._world_size)])
                pool = pool[items:]
        return batches

    def _sorted(self, draws: np.ndarray) -> np.ndarray:
        return draws[np.argsort(self._lengths[draws[:, 0]], kind="stable")]


def load_batches(
    dataset: SequenceDataset | WindowsDataset, batches: LengthBatches, *, workers: int = 0, pinned: bool = False
) -> Iterator[MotionBatch] | Iterator[WindowBatch]:
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
        collate_fn=dataset.collate,
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
