"""Windows of motion prediction as a dataset, and endless batches of similar length for both kinds of data.

A window (docs/specification/motion-prediction.md) is a whole item, observed and future frames. Its start is drawn anew
in every epoch, within the stretch of ``observed`` starts that the item stands for, so that a network sees more than the
windows that are scored. The order of batches is a function of seed and step.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch.utils.data import DataLoader, Dataset

from prbench.errors import TableError, UsageError
from prbench.randomness import hash_fraction, named_generator
from prbench_adapters.tensors import TensorRecord
from prbench_adapters.training.dataset import SequenceDataset
from prbench_adapters.training.store import REFIT, parts_of
from prbench_benchmarks.motion_prediction import joint_sets
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.protocol import FrameName
from prbench_benchmarks.motion_prediction.table import Run, WindowsTable

# Share of the published training segments that validate, as the published split has no such part.
_HELD_OUT = 0.1


class WindowChoice(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a network is shown of the windows, and of which people.

    Attributes:
        frame: Frame of the joints: the room's, or that of the last observed pose.
        split: ``published``: the training part of the published evaluation, of which a tenth of the segments validates.
        left_out: Participants who are not shown, for evaluations that leave one out.
        augmentation: ``mirror``: half of the windows in a mirror, sides exchanged, and in the room's frame each turned.
            ``published``: whole batches turned and negated, without exchange of sides, as GazeMoDiff's public program
            does on MoGaze. Or ``none``.
    """

    condition: Condition = Condition.POSE_GAZE
    frame: FrameName = "last-pose"
    split: Literal["dataset", "published"] = "dataset"
    left_out: tuple[str, ...] = ()
    augmentation: Literal["mirror", "published", "none"] = "mirror"


class SeenWindows(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The windows that a network was trained on, and the only ones that it can predict."""

    condition: Condition
    frame: FrameName
    joint_set: str
    fps: float
    observed: int
    predicted: int

    @property
    def frames(self) -> int:
        """Frames of a window."""
        return self.observed + self.predicted

    @property
    def joints(self) -> joint_sets.JointSet:
        """The joints by name."""
        return joint_sets.joint_set(self.joint_set)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints.names)

    @property
    def direction(self) -> bool:
        """True if a direction stands behind the joints."""
        return self.condition is not Condition.POSE

    @property
    def nodes(self) -> int:
        """Joints, and the direction if there is one."""
        return self.n_joints + self.direction


@dataclass(frozen=True)
class WindowItem:
    """One window, room, metres, Y up; arrays are views of the run.

    Attributes:
        direction: Direction of gaze or of the head; None under ``pose``.
    """

    joints: Float[np.ndarray, "frames joints 3"]
    direction: Float[np.ndarray, "frames 3"] | None
    direction_valid: Bool[np.ndarray, " frames"]
    shape: SeenWindows


@dataclass(frozen=True)
class WindowBatch(TensorRecord):
    """B windows in the frame that the network works in; metres, Y up.

    Attributes:
        motion: Joints, and behind them the direction of gaze or of the head, if the condition has one.
        direction_valid: Which observed directions were measured; None without direction.
    """

    motion: Float[torch.Tensor, "windows frames nodes 3"]
    direction_valid: Bool[torch.Tensor, "windows observed"] | None

    def __len__(self) -> int:
        return len(self.motion)


def collate_windows(items: Sequence[WindowItem]) -> WindowBatch:
    """Stack items in the frame that they are wanted in."""
    shape = items[0].shape
    joints = np.stack([item.joints for item in items]).astype(np.float64)
    last = shape.observed - 1
    batch_from_room = np.tile(np.eye(4), (len(items), 1, 1))
    if shape.frame == "last-pose":
        batch_from_room = joint_sets.invert_each(shape.joints.last_pose_frame(joints[:, last]))
    nodes = [joint_sets.transform_each(batch_from_room, joints)]
    valid = None
    directions = [item.direction for item in items if item.direction is not None]
    if directions:
        turn = joint_sets.rotations_alone(batch_from_room)
        nodes.append(joint_sets.transform_each(turn, np.stack(directions))[:, :, None])
        valid = torch.from_numpy(np.stack([item.direction_valid[: shape.observed] for item in items]))
    return WindowBatch(torch.from_numpy(np.concatenate(nodes, axis=2).astype(np.float32)), valid)


class DrawnDataset(Dataset[Any]):
    """Stretches of the runs of some tables, of which a window is drawn anew in every epoch.

    Attributes:
        tables: The opened tables.
        counts: Items of each table.
        lengths: Frames of each item.
        collate: Makes a batch of items.
    """

    tables: tuple[Any, ...]
    counts: tuple[int, ...]
    lengths: Int[np.ndarray, " items"]
    collate: Callable[..., Any]

    def __len__(self) -> int:
        return len(self.lengths)

    def spread(self, limit: int) -> tuple[int, ...]:
        """Places of at most ``limit`` items of each table, at equal distances: every recording has its share."""
        places: list[int] = []
        first = 0
        for count in self.counts:
            wanted = min(limit, count)
            places += [first + place * count // wanted for place in range(wanted)]
            first += count
        return tuple(places)


class WindowsDataset(DrawnDataset):
    """All windows of some tables and a split, held in memory: about 300 bytes a frame.

    A start is allowed where no frame of the window lacks its body and, in tables with gaze, enough observed frames have
    measured gaze: under every condition the same windows, so that conditions can be compared. ``dataset[index]`` draws
    its start as in epoch 0, ``dataset[index, epoch]`` as in any other; it depends on the seed, the epoch and the index
    alone.

    Args:
        tables: Folders of windows, or opened tables; of one joint set, rate and length of windows.
        split: ``train``, ``validation``, or ``train+validation``.
        choice: What is shown, and of whom.
        seed: Seed of the starts.

    Raises:
        UsageError: if tables do not fit together, or one lacks the gaze that the condition wants.
        TableError: if a table cannot be read, or has no window of this split.
    """

    collate = staticmethod(collate_windows)

    def __init__(
        self,
        tables: Iterable[WindowsTable | Path | str],
        *,
        split: str = "train",
        choice: WindowChoice | None = None,
        seed: int = 0,
    ) -> None:
        opened = [table if isinstance(table, WindowsTable) else WindowsTable.open(table) for table in tables]
        self.choice = choice or WindowChoice()
        self.shape = _common_shape(opened, self.choice)
        self.fps = self.shape.fps
        self.tables = tuple(opened)
        self.split, self.seed = split, seed
        self._runs: list[Run] = []
        self._stretches: list[tuple[int, Int[np.ndarray, " starts"]]] = []
        self.counts = tuple(self._read(table) for table in opened)
        self.lengths = np.full(len(self._stretches), self.shape.frames)

    def __getitem__(self, index: int | tuple[int, int]) -> WindowItem:
        """Return the item of a stretch, drawn for epoch 0, or for the epoch of a pair ``(index, epoch)``."""
        place, epoch = index if isinstance(index, tuple) else (index, 0)
        row, starts = self._stretches[place]
        start = int(starts[named_generator("prbench-training-window", self.seed, epoch, place).integers(len(starts))])
        run = self._runs[row]
        part = slice(start, start + self.shape.frames)
        direction = None
        valid = run.gaze_valid[part]
        if self.choice.condition is Condition.POSE_GAZE:
            direction = run.gaze[part]
        elif self.choice.condition is Condition.POSE_HEAD:
            direction = run.head_direction[part]
            valid = np.ones(self.shape.frames, dtype=bool)
        return WindowItem(run.joints[part], direction, valid, self.shape)

    def _read(self, table: WindowsTable) -> int:
        """Take up the runs of one table; returns its number of items."""
        if self.choice.condition is Condition.POSE_GAZE and not table.info.has_gaze:
            problem = "found none in any recording. Add --set model.windows.condition=pose+head, or pose."
            raise UsageError(f"{table.folder}: expected recorded gaze for the condition 'pose+gaze', {problem}")
        rows = [row for row, run in enumerate(table.runs.to_pylist()) if self._is_wanted(run)]
        before = len(self._stretches)
        for _, run in table.iterate_runs(rows):
            starts = _allowed_starts(run, self.shape, table.info.fewest_gaze_frames if table.info.has_gaze else 0)
            if len(starts):
                borders = np.flatnonzero(np.diff(starts // self.shape.observed)) + 1
                self._stretches += [(len(self._runs), part) for part in np.split(starts, borders)]
                self._runs.append(run)
        found = len(self._stretches) - before
        if not found:
            splits = ", ".join(sorted(set(table.runs["split"].to_pylist())))
            raise TableError(
                f"{table.folder}: expected windows of split '{self.split}' ({self.choice.split}) with"
                f" {self.shape.frames} frames, found none. Its runs are of the splits: {splits}."
            )
        return found

    def _is_wanted(self, run: dict[str, str]) -> bool:
        if run["participant_id"] in self.choice.left_out:
            return False
        if self.choice.split == "dataset":
            return run["split"] in parts_of(self.split)
        if run["published_split"] != "train":
            return False
        held_out = hash_fraction("prbench-held-out-segment", run["run_id"]) < _HELD_OUT
        return self.split == REFIT or held_out is (self.split == "validation")


def _common_shape(tables: Sequence[WindowsTable], choice: WindowChoice) -> SeenWindows:
    """Return the shape of the windows of all tables, which have to be different ones."""
    if not tables:
        raise UsageError("no table was given; name at least one folder of windows.")
    digests = [table.info.content_digest for table in tables]
    folders = [table.folder for table in tables]
    if len(set(folders)) < len(folders) or len(set(digests)) < len(digests):
        raise UsageError("a table of windows was given twice.")
    shapes = {}
    for table in tables:
        size = (table.info.joint_set, table.info.fps, table.info.observed_frames, table.info.future_frames)
        shapes[table.folder] = SeenWindows(choice.condition, choice.frame, *size)
    if len(set(shapes.values())) > 1:
        found = "; ".join(
            f"{folder}: {shape.joint_set}, {shape.fps:g} frames a second, {shape.observed} + {shape.predicted} frames"
            for folder, shape in shapes.items()
        )
        raise UsageError(f"expected windows of one joint set, rate and length, found {found}.")
    return shapes[tables[0].folder]


def _allowed_starts(run: Run, shape: SeenWindows, fewest_gaze: int) -> Int[np.ndarray, " starts"]:
    """First frames of the windows of a run with a body in every frame, and enough measured gaze."""
    count = run.n_frames - shape.frames + 1
    if count < 1:
        return np.empty(0, dtype=np.int64)
    bodies = np.concatenate(([0], np.cumsum(run.joints_valid)))
    gaze = np.concatenate(([0], np.cumsum(run.gaze_valid)))
    whole = bodies[shape.frames :] - bodies[:count] == shape.frames
    return np.flatnonzero(whole & (gaze[shape.observed : shape.observed + count] - gaze[:count] >= fewest_gaze))


Items = SequenceDataset | DrawnDataset
# Index of an item, and the epoch that it is drawn for.
Draw = tuple[int, int]
# Batches that are sorted by length together: enough for little padding, few enough that batches stay random.
_POOL = 32
_AHEAD = 4  # batches that each worker prepares in advance


class LengthBatches:
    """Chooses the items of each batch: a batch sampler for a DataLoader, without end.

    Every epoch shows the items in a new order. Within a window of that order the items of similar length come together,
    then the batches change places. What step s shows depends on ``(seed, s, rank, world_size)`` and nothing else, so a
    run goes on anywhere with ``start_step``. The processes of one run share the batches of a step: none of them sees an
    item of another in that epoch. Items that fill no whole batch are left to the next epochs.

    Args:
        dataset: Its lengths decide; a set with fewer items than one step needs is shown several times over.
        batch_size: Items that each process gets at a step.
        seed: Seed of the order.
        rank: Which of the processes this is, from 0.
        world_size: How many processes train together.
        start_step: The first step that is shown.

    Raises:
        UsageError: if a number is out of range.
    """

    def __init__(
        self, dataset: Items, batch_size: int, seed: int = 0, rank: int = 0, world_size: int = 1, start_step: int = 0
    ) -> None:
        if batch_size < 1 or not 0 <= rank < world_size or start_step < 0:
            raise UsageError(
                f"batch_size {batch_size}, rank {rank} of {world_size} and start_step {start_step} do not fit together."
            )
        self._lengths = dataset.lengths
        self._together = batch_size * world_size
        self._seed, self._rank, self._world_size, self._start_step = seed, rank, world_size, start_step

    def __iter__(self) -> Iterator[list[Draw]]:
        """Yield the batches of this process from ``start_step`` on, without end."""
        epoch, skipped = divmod(self._start_step, max(len(self._lengths) // self._together, 1))
        while True:
            for batch in self._epoch(epoch)[skipped:]:
                yield [(int(index), int(turn)) for index, turn in batch[self._rank :: self._world_size]]
            epoch = epoch + 1
            skipped = 0

    def _epoch(self, epoch: int) -> list[Int[np.ndarray, "items 2"]]:
        """All batches of one epoch for all processes together: rows of (index, epoch of the draw)."""
        generator = named_generator("prbench-training-order", self._seed, epoch)
        count = len(self._lengths)
        turns = max(-(-self._together // count), 1)
        order = np.concatenate([generator.permutation(count) for _ in range(turns)])
        turn = np.repeat(np.arange(epoch * turns, (epoch + 1) * turns), count)
        # A small set is shown several times over; each turn draws other crops and captions.
        draws = np.column_stack([order, turn])
        whole = len(draws) // self._together * self._together
        batches = []
        for start in range(0, whole, _POOL * self._together):
            pool = draws[start : min(start + _POOL * self._together, whole)]
            pool = pool[np.argsort(self._lengths[pool[:, 0]], kind="stable")]
            batches += [pool[first : first + self._together] for first in range(0, len(pool), self._together)]
        return [batches[place] for place in generator.permutation(len(batches))]


def load_batches(dataset: Items, batches: LengthBatches, *, workers: int = 0, pinned: bool = False) -> Iterator[Any]:
    """Return the batches that a sampler plans, made into tensors; without end, the same ones for any number of workers.

    Args:
        dataset: The items. Workers open its memory-mapped files again; nothing is copied to them.
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
        worker_init_fn=_leave_at_once,
    )
    return iter(loader)


def _leave_at_once(worker: int) -> None:  # noqa: ARG001 - what torch hands over
    """Let a worker end without tidying up Python, in which threads that still send batches would abort it."""
    Finalize(None, os._exit, args=(0,), exitpriority=-100)
