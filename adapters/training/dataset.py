"""Motions with their conditions as a dataset for PyTorch: public, for whoever trains on prbench's tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch.utils.data import Dataset

from prbench.engine import IN_PROCESS, Engine
from prbench.errors import TableError, UsageError
from prbench.files.storage import cache_folder
from prbench.randomness import named_generator
from prbench.representation import Mode, Statistics, StatisticsAccumulator
from prbench.sequences import SPLITS, CorpusTable, SequenceTable
from prbench_adapters.tensors import TensorRecord
from prbench_adapters.training import store as stores
from prbench_adapters.training.configuration import DataConfiguration, TrainingConfiguration

Goal = Literal["pose", "location"]
_KNOWN = {"split": (*SPLITS, stores.REFIT), "crop": ("end", "random"), "mode": ("continuous", "reference")}
# Metres, or metres a second: entries that hardly vary are not blown up.
_STD_FLOOR = 0.01


@dataclass(frozen=True)
class MotionItem:
    """One motion as it is trained on. Canonical frame of its first frame, metres; arrays may be read-only views.

    Attributes:
        features: Raw features, one row a frame, not standardised (docs/specification/humanml3d.md#forward-conversion).
        text: Caption, one of those of the row.
        previous_joints: The frame before the first, for the initial velocity.
        goal_location: Place that is reached; NaN for motions of a corpus.
    """

    features: Float[np.ndarray, "n 263"]
    joints: Float[np.ndarray, "n 22 3"]
    text: str
    previous_joints: Float[np.ndarray, "22 3"]
    goal_location: Float[np.ndarray, "3"]
    fps: float
    sequence_id: str

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.joints)

    @property
    def initial_joints(self) -> Float[np.ndarray, "22 3"]:
        """The first frame."""
        return self.joints[0]

    @property
    def goal_joints(self) -> Float[np.ndarray, "22 3"]:
        """The last frame."""
        return self.joints[-1]


@dataclass(frozen=True)
class MotionBatch(TensorRecord):
    """B motions. Canonical frame of each one's first frame, metres; frames from ``n_frames[i]`` on are zeros.

    Attributes:
        features: Raw features, not standardised; standardise, then set padding to zero.
        padding: True where there is no frame.
        initial_joints: The first frame.
        previous_joints: The frame before it.
        goal_joints: The last frame.
        goal_location: NaN for motions of a corpus.
    """

    features: Float[torch.Tensor, "batch frames 263"]
    joints: Float[torch.Tensor, "batch frames 22 3"]
    padding: Bool[torch.Tensor, "batch frames"]
    n_frames: Int[torch.Tensor, " batch"]
    text: tuple[str, ...]
    initial_joints: Float[torch.Tensor, "batch 22 3"]
    previous_joints: Float[torch.Tensor, "batch 22 3"]
    goal_joints: Float[torch.Tensor, "batch 22 3"]
    goal_location: Float[torch.Tensor, "batch 3"]
    fps: float
    sequence_id: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.n_frames)


def collate(items: Sequence[MotionItem]) -> MotionBatch:
    """Stack items, padded with zeros to the longest of them; give it to a DataLoader as ``collate_fn``.

    Raises:
        ValueError: if there are none, or they differ in frame rate.
    """
    rates = {item.fps for item in items}
    if len(rates) != 1:
        raise ValueError(f"a batch needs items of one frame rate, got {sorted(rates)}")
    n_frames = torch.tensor([item.n_frames for item in items], dtype=torch.int64)
    features, joints = (_padded([getattr(item, name) for item in items]) for name in ("features", "joints"))
    padding = torch.arange(int(n_frames.max())) >= n_frames[:, None]
    conditions = (
        torch.from_numpy(np.stack([getattr(item, name) for item in items]).astype(np.float32, copy=False))
        for name in ("initial_joints", "previous_joints", "goal_joints", "goal_location")
    )
    texts, names = (tuple(getattr(item, name) for item in items) for name in ("text", "sequence_id"))
    return MotionBatch(features, joints, padding, n_frames, texts, *conditions, fps=rates.pop(), sequence_id=names)


def _padded(arrays: list[np.ndarray]) -> torch.Tensor:
    whole = np.empty((len(arrays), max(map(len, arrays)), *arrays[0].shape[1:]), dtype=np.float32)
    for row, array in zip(whole, arrays):
        row[: len(array)], row[len(array) :] = array, 0
    return torch.from_numpy(whole)


class SequenceDataset(Dataset[MotionItem]):
    """Rows of sequence tables and text-motion corpora as features, joints and conditions.

    Features of whole rows are computed once, kept in a memory-mapped file in prbench's cache folder and shared by all
    processes; an item is a few views of it. An item depends on ``(seed, epoch, index)`` alone: never on who asked for
    it before, or in which process. ``dataset[index]`` draws as in epoch 0, ``dataset[index, epoch]`` as in any other.

    Example:
        Batches of similar length for a model of one's own (``docs/training-data.md`` trains one)::

            from torch.utils.data import DataLoader
            from prbench_adapters.training import LengthBatches, SequenceDataset, collate

            data = SequenceDataset(["tables/hot3d", "tables/adt"], max_frames=150)
            order = LengthBatches(data, batch_size=64, seed=0)
            for step, batch in enumerate(DataLoader(data, batch_sampler=order, collate_fn=collate)):
                ...  # batch.features (64, N, 263), batch.padding, batch.initial_joints, batch.goal_location, batch.text

    Args:
        tables: Folders of built datasets or corpora, or opened tables; one or several, of one frame rate.
        split: ``train``, ``validation``, ``test``, or ``train+validation`` for both.
        max_frames: The longest item; longer rows are cut.
        crop: What is kept of a longer row: its ``end`` with the goal, or a part at a ``random`` start. Either way it is
            encoded anew in the canonical frame of its first kept frame, and the frame before that is its predecessor
            (docs/specification/pr-model.md#training).
        mode: Mode of the representation: ``continuous``, or ``reference`` with the original's quirks.
        seed: Seed of captions and random crops.
        cache: Folder of the feature stores; prbench's cache folder by default.
        engine: Engine that encodes rows for a store that is not there yet; changes no byte of it.

    Raises:
        UsageError: if a value is not one of those above, or a table is given twice.
        TableError: if a table cannot be read, has no usable row of this split, or the tables differ in frame rate.
    """

    collate = staticmethod(collate)

    def __init__(
        self,
        tables: stores.Table | Path | str | Iterable[stores.Table | Path | str],
        *,
        split: str = "train",
        max_frames: int = 241,
        crop: stores.Crop = "end",
        mode: Mode = "continuous",
        seed: int = 0,
        cache: Path | None = None,
        engine: Engine = IN_PROCESS,
    ) -> None:
        for what, value in (("split", split), ("crop", crop), ("mode", mode)):
            if value not in _KNOWN[what]:
                raise UsageError(f"{what} '{value}' is not known; it is one of {', '.join(_KNOWN[what])}.")
        if max_frames < 2:
            raise UsageError(f"max_frames is {max_frames}; an item needs at least 2 frames.")
        given = [tables] if isinstance(tables, SequenceTable | CorpusTable | Path | str) else list(tables)
        opened = [stores.open_table(table) for table in given]
        # All tables have one frame rate, and are different ones.
        if not opened:
            raise UsageError("no table was given; name at least one built dataset or corpus.")
        digests = [table.info.content_digest for table in opened]
        if len(set(digests)) < len(digests):
            twice = next(table for table in opened if digests.count(table.info.content_digest) > 1)
            raise UsageError(f"{twice.folder}: this table was given twice.")
        rates = {table.folder: stores.frame_rate(table, split) for table in opened}
        if len(set(rates.values())) > 1:
            found = ", ".join(f"{folder}: {rate:g}" for folder, rate in rates.items())
            remedy = "Build them again with one --fps."
            raise TableError(f"expected tables of one frame rate, found frames per second of {found}. {remedy}")
        self.fps = next(iter(rates.values()))
        self.tables: tuple[stores.Table, ...] = tuple(opened)
        self.split, self.max_frames, self.seed = split, max_frames, seed
        self.mode: Mode = mode
        self._stores: list[stores.FeatureStore] = []
        left_out: list[stores.LeftOut] = []
        wanted = DataConfiguration(max_frames=max_frames, crop=crop, mode=mode)
        for table in opened:
            parts = stores.parts_of(split)
            if len(parts) > 1:
                # Of several splits an empty one is left out (a small table has no validation sequences).
                present = set(table.scalars(columns=["split"])["split"].to_pylist())
                parts = [part for part in parts if part in present]
            for part in parts:
                folder = cache or cache_folder() / "training"
                store, unusable = stores.table_store(table, part, wanted, folder, engine=engine)
                self._stores.append(store)
                left_out += unusable
        # Rows that cannot be encoded, with the reason of each.
        self.left_out: tuple[stores.LeftOut, ...] = tuple(left_out)
        self._starts = np.cumsum([0, *(len(store) for store in self._stores)])

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __getitem__(self, index: int | tuple[int, int]) -> MotionItem:
        """Return the item of a row, drawn for epoch 0, or for the epoch of a pair ``(index, epoch)``."""
        row, epoch = index if isinstance(index, tuple) else (index, 0)
        if not -len(self) <= row < len(self):
            raise IndexError(f"item {row} of {len(self)}")
        number = int(np.searchsorted(self._starts, row % len(self), side="right")) - 1
        store = self._stores[number]
        place = row % len(self) - int(self._starts[number])
        name = store.sequence_ids[place]
        motion, features = store.row(place)
        text, *others = store.texts(place)
        if features is None or others:
            # A function of seed, epoch and row alone: workers and resumption change no draw.
            generator = named_generator("prbench-training-item", self.seed, epoch, row)
            text = (text, *others)[int(generator.integers(1 + len(others)))]
            if features is None:
                start = int(generator.integers(motion.n_frames - self.max_frames + 1))
                motion = stores.cut(motion, start, self.max_frames, name=name)
                features = stores.encoded(motion, self.mode, name=name, checked=True)
        return MotionItem(
            features, motion.joints, text, motion.previous_joints, motion.goal_location, self.fps, sequence_id=name
        )

    @cached_property
    def lengths(self) -> Int[np.ndarray, " rows"]:
        """Frames of every item."""
        return np.minimum(np.concatenate([store.n_frames for store in self._stores]), self.max_frames)

    @cached_property
    def sequence_ids(self) -> tuple[str, ...]:
        """Ids of all rows."""
        return tuple(name for store in self._stores for name in store.sequence_ids)

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """All distinct captions, sorted, so that each is encoded once."""
        return tuple(sorted({text for store in self._stores for row in range(len(store)) for text in store.texts(row)}))

    def statistics(self, change: Callable[[np.ndarray], np.ndarray] = lambda features: features) -> Statistics:
        """Mean and block-wise standard deviation of the raw features (docs/specification/humanml3d.md#normalisation).

        Over every frame of every row; of a row that is cut at random, over the part that epoch 0 shows.

        Args:
            change: Turns the features of an item into those that are measured.
        """
        accumulator = StatisticsAccumulator()
        for index in range(len(self)):
            accumulator.add(change(self[index].features))
        return accumulator.result()

    def condition_statistics(self, goal: Goal) -> tuple[Float[np.ndarray, " size"], Float[np.ndarray, " size"]]:
        """Mean and standard deviation of the condition vector (docs/specification/pr-model.md#network).

        The vector is ``[initial pose 66, initial velocity 66, goal 3 or 66]``, m and m/s; the deviation is floored at
        0.01.

        Raises:
            TableError: if goal locations are asked for and a row has none.
        """
        vectors = []
        for index in range(len(self)):
            item = self[index]
            # m/s, not metres a frame: tables of another rate give the same vector.
            velocity = (item.initial_joints - item.previous_joints) * np.float32(item.fps)
            target = item.goal_joints if goal == "pose" else item.goal_location
            if np.isnan(target).any():
                why = "because it comes from a text-motion corpus. Train a goal-conditioned model on sequence tables."
                raise TableError(f"{item.sequence_id}: expected a goal location, found none, {why}")
            vectors.append(np.concatenate([np.ravel(part) for part in (item.initial_joints, velocity, target)]))
        stacked = np.stack(vectors).astype(np.float64)
        return stacked.mean(axis=0).astype(np.float32), np.maximum(stacked.std(axis=0), _STD_FLOOR).astype(np.float32)


def configured_dataset(
    tables: Iterable[stores.Table | Path], configuration: TrainingConfiguration, *, split: str, engine: Engine
) -> SequenceDataset:
    """Return the sequences of a split, as a configuration wants them."""
    wanted: dict[str, Any] = {name: getattr(configuration.data, name) for name in ("max_frames", "crop", "mode")}
    return SequenceDataset(list(tables), split=split, **wanted, seed=configuration.training.seed, engine=engine)
