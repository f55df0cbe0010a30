"""Mean and standard deviation of the vector that conditions the P&R model (docs/specification/pr-model.md#network)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from prbench.errors import TableError

if TYPE_CHECKING:
    from prbench.training.dataset import MotionItem

Goal = Literal["none", "pose", "location"]

STD_FLOOR = 0.01
"""Metres, or metres a second: entries that hardly vary are not blown up."""


@dataclass(frozen=True)
class ConditionStatistics:
    """Of ``[initial pose 66, initial velocity 66, goal 3 or 66]``, metres and metres per second; empty without goal."""

    mean: Float[np.ndarray, " size"]
    std: Float[np.ndarray, " size"]


def condition_vector(item: MotionItem, goal: Goal) -> Float[np.ndarray, " size"]:
    """The unscaled vector of one item."""
    if goal == "none":
        return np.empty(0, dtype=np.float32)
    velocity = (item.initial_joints - item.previous_joints) * np.float32(item.fps)
    target = item.goal_joints if goal == "pose" else item.goal_location
    return np.concatenate([np.ravel(part) for part in (item.initial_joints, velocity, target)])


def condition_statistics(items: Iterable[MotionItem], goal: Goal) -> ConditionStatistics:
    """Statistics over items, one after the other; the standard deviation is floored at :data:`STD_FLOOR`.

    Raises:
        TableError: if goal locations are asked for and an item has none.
    """
    vectors = []
    for item in items:
        vector = condition_vector(item, goal)
        if np.isnan(vector).any():
            raise TableError(
                f"{item.sequence_id}: expected a goal location, found none, because it comes from a text-motion corpus."
                " Train a goal-conditioned model on sequence tables."
            )
        vectors.append(vector)
    stacked = np.stack(vectors).astype(np.float64)
    std = np.maximum(stacked.std(axis=0), STD_FLOOR)
    return ConditionStatistics(stacked.mean(axis=0).astype(np.float32), std.astype(np.float32))
