"""Endless batches of similar length whose order is a pure function of seed and step."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from jaxtyping import Int

from prbench.errors import UsageError
from prbench.randomness import named_generator
from prbench.training.dataset import SequenceDataset

Draw = tuple[int, int]
"""Index of an item, and the epoch that it is drawn for."""

_POOL = 32
"""Batches that are sorted by length together: enough for little padding, few enough that batches stay random."""


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
        dataset: SequenceDataset,
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
            epoch, skipped = epoch + 1, 0

    def _beginning(self) -> tuple[int, int]:
        """The epoch that ``start_step`` lies in, and the batches of it that come before."""
        if self._unit == "sequences":
            together = self._batch_size * self._world_size
            return divmod(self._start_step, max(len(self._lengths) // together, 1))
        epoch, left = 0, self._start_step
        while left >= (count := len(self._epoch(epoch))):
            epoch, left = epoch + 1, left - count
        return epoch, left

    def _epoch(self, epoch: int) -> list[Int[np.ndarray, "items 2"]]:
        """All batches of one epoch for all processes together: rows of (index, epoch of the draw)."""
        generator = named_generator("prbench-training-order", self._seed, epoch)
        needed = self._world_size * (self._batch_size if self._unit == "sequences" else 1)
        turns = max(-(-needed // len(self._lengths)), 1)
        order = np.concatenate([generator.permutation(len(self._lengths)) for _ in range(turns)])
        turn = np.repeat(np.arange(epoch * turns, (epoch + 1) * turns), len(self._lengths))
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
