"""One motion as it is trained on, batches of such motions as tensors, and statistics of their condition vectors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from prbench.errors import TableError

Goal = Literal["none", "pose", "location"]
_STD_FLOOR = 0.01
"""Metres, or metres a second: entries that hardly vary are not blown up."""


@dataclass(frozen=True)
class MotionItem:
    """One motion as it is trained on. Canonical frame of its first frame, metres; arrays may be read-only views."""

    features: Float[np.ndarray, "n 263"]
    """Raw features, one row a frame, not standardised (docs/specification/humanml3d.md#forward-conversion)."""
    joints: Float[np.ndarray, "n 22 3"]
    n_frames: int
    text: str
    """Caption, one of those of the row."""
    initial_joints: Float[np.ndarray, "22 3"]
    """The first frame."""
    previous_joints: Float[np.ndarray, "22 3"]
    """The frame before it, for the initial velocity."""
    goal_joints: Float[np.ndarray, "22 3"]
    """The last frame."""
    goal_location: Float[np.ndarray, "3"]
    """Place that is reached; NaN for motions of a corpus."""
    fps: float
    sequence_id: str


@dataclass(frozen=True)
class ConditionStatistics:
    """Statistics of ``[initial pose 66, initial velocity 66, goal 3 or 66]``, m and m/s; empty without goal."""

    mean: Float[np.ndarray, " size"]
    std: Float[np.ndarray, " size"]


def condition_statistics(items: Iterable[MotionItem], goal: Goal) -> ConditionStatistics:
    """Statistics over items, one after the other; the standard deviation is floored at 0.01.

    Raises:
        TableError: if goal locations are asked for and an item has none.
    """
    vectors = []
    for item in items:
        vector = _condition_vector(item, goal)
        if np.isnan(vector).any():
            raise TableError(
                f"{item.sequence_id}: expected a goal location, found none, because it comes from a text-motion corpus."
                " Train a goal-conditioned model on sequence tables."
            )
        vectors.append(vector)
    stacked = np.stack(vectors).astype(np.float64)
    std = np.maximum(stacked.std(axis=0), _STD_FLOOR)
    return ConditionStatistics(stacked.mean(axis=0).astype(np.float32), std.astype(np.float32))


def _condition_vector(item: MotionItem, goal: Goal) -> Float[np.ndarray, " size"]:
    """The unscaled vector of one item."""
    if goal == "none":
        return np.empty(0, dtype=np.float32)
    # m/s, not metres a frame: tables of another rate give the same vector.
    velocity = (item.initial_joints - item.previous_joints) * np.float32(item.fps)
    target = item.goal_joints if goal == "pose" else item.goal_location
    return np.concatenate([np.ravel(part) for part in (item.initial_joints, velocity, target)])


@dataclass(frozen=True)
class MotionBatch:
    """B motions. Canonical frame of each one's first frame, metres; frames from ``n_frames[i]`` on are zeros."""

    features: Float[torch.Tensor, "batch frames 263"]
    """Raw features, not standardised; standardise, then set padding to zero."""
    joints: Float[torch.Tensor, "batch frames 22 3"]
    padding: Bool[torch.Tensor, "batch frames"]
    """True where there is no frame."""
    n_frames: Int[torch.Tensor, " batch"]
    text: tuple[str, ...]
    initial_joints: Float[torch.Tensor, "batch 22 3"]
    """The first frame."""
    previous_joints: Float[torch.Tensor, "batch 22 3"]
    """The frame before it."""
    goal_joints: Float[torch.Tensor, "batch 22 3"]
    """The last frame."""
    goal_location: Float[torch.Tensor, "batch 3"]
    """NaN for motions of a corpus."""
    fps: float
    sequence_id: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.n_frames)

    def to(self, device: torch.device | str, *, non_blocking: bool = False) -> MotionBatch:
        """The batch on a device."""
        return self._each(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> MotionBatch:
        """The batch in page-locked memory, from where a copy to a GPU overlaps with its work."""
        return self._each(lambda tensor: tensor.pin_memory())

    def _each(self, change: Callable[[torch.Tensor], torch.Tensor]) -> MotionBatch:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{k: change(v) for k, v in values.items() if isinstance(v, torch.Tensor)})


def collate(items: Sequence[MotionItem]) -> MotionBatch:
    """Stack items, padded with zeros to the longest of them; give it to a DataLoader as ``collate_fn``.

    Raises:
        ValueError: if there are none, or they differ in frame rate.
    """
    rates = {item.fps for item in items}
    if len(rates) != 1:
        raise ValueError(f"a batch needs items of one frame rate, got {sorted(rates)}")
    n_frames = torch.tensor([item.n_frames for item in items], dtype=torch.int64)
    return MotionBatch(
        features=_padded([item.features for item in items]),
        joints=_padded([item.joints for item in items]),
        padding=torch.arange(int(n_frames.max())) >= n_frames[:, None],
        n_frames=n_frames,
        text=tuple(item.text for item in items),
        initial_joints=_stacked([item.initial_joints for item in items]),
        previous_joints=_stacked([item.previous_joints for item in items]),
        goal_joints=_stacked([item.goal_joints for item in items]),
        goal_location=_stacked([item.goal_location for item in items]),
        fps=rates.pop(),
        sequence_id=tuple(item.sequence_id for item in items),
    )


def _padded(arrays: list[np.ndarray]) -> torch.Tensor:
    longest = max(len(array) for array in arrays)
    whole = np.empty((len(arrays), longest, *arrays[0].shape[1:]), dtype=np.float32)
    for row, array in zip(whole, arrays):
        row[: len(array)], row[len(array) :] = array, 0
    return torch.from_numpy(whole)


def _stacked(arrays: list[np.ndarray]) -> torch.Tensor:
    return torch.from_numpy(np.stack(arrays).astype(np.float32, copy=False))
