"""The vector p is made of: initial pose, initial velocity and goal, scaled, with dropped conditions as zeros.

``methods/pr-model.md`` sections 1 and 2 (*Prime and Reach*, section 4.1). Everything is given in the canonical frame of
the first pose, in metres; velocities are in metres per second.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float

from prbench.contract import ConditionBatch
from prbench.skeleton import N_JOINTS

Goal = Literal["none", "pose", "location"]

_POSE_SIZE = 3 * N_JOINTS
_GOAL_SIZE: dict[Goal, int] = {"pose": _POSE_SIZE, "location": 3}

INITIAL_POSE = slice(0, _POSE_SIZE)
INITIAL_VELOCITY = slice(_POSE_SIZE, 2 * _POSE_SIZE)
GOAL = slice(2 * _POSE_SIZE, None)
SLICES = {"initial_pose": INITIAL_POSE, "initial_velocity": INITIAL_VELOCITY, "goal": GOAL}
"""Where each condition stands in the vector, under the names that a configuration drops it by."""


def condition_size(goal: Goal) -> int:
    """Entries of the vector: 198 with a goal pose, 135 with a location, 0 for a model that knows its text only."""
    return 2 * _POSE_SIZE + _GOAL_SIZE[goal] if goal != "none" else 0


def raw_condition(
    initial_joints: Float[torch.Tensor, "batch 22 3"],
    previous_joints: Float[torch.Tensor, "batch 22 3"],
    goal: Float[torch.Tensor, "batch 22 3"] | Float[torch.Tensor, "batch 3"],
    fps: float,
) -> Float[torch.Tensor, "batch size"]:
    """Initial pose (m), initial velocity (m/s) and goal (m) of each sequence, flattened and joined, unscaled.

    Args:
        initial_joints: The first frame, canonical, metres.
        previous_joints: The frame before it, same frame.
        goal: The last frame, or the location to reach.
        fps: Frames per second.
    """
    velocity = (initial_joints - previous_joints) * fps
    return torch.cat([part.flatten(1) for part in (initial_joints, velocity, goal)], dim=1).float()


def raw_condition_of(batch: ConditionBatch, goal: Goal) -> Float[torch.Tensor, "batch size"] | None:
    """:func:`raw_condition` of what a method is given; None for a model without a goal.

    Raises:
        ValueError: if the batch holds no goal of this kind.
    """
    if goal == "none":
        return None
    target = batch.goal_joints if goal == "pose" else batch.goal_location
    if target is None or batch.initial_joints is None or batch.previous_joints is None:
        raise ValueError(f"a model that was trained on goals of kind '{goal}' cannot use '{batch.condition.value}'")
    poses = (torch.as_tensor(part, dtype=torch.float32) for part in (batch.initial_joints, batch.previous_joints))
    return raw_condition(*poses, torch.as_tensor(target, dtype=torch.float32), batch.fps)


@dataclass(frozen=True)
class ConditionScaling:
    """How a raw vector becomes what the network sees: ``(raw - mean) / std``, dropped conditions zero."""

    mean: Float[torch.Tensor, " size"]
    std: Float[torch.Tensor, " size"]
    dropped: frozenset[str] = frozenset()
    """Of ``initial_pose``, ``initial_velocity``, ``goal``; absent in training and test alike (table 3)."""

    @classmethod
    def literal(cls, goal: Goal, fps: float, dropped: Iterable[str] = ()) -> ConditionScaling:
        """The study's own words, no scaling: metres, and for the velocity metres per frame (``pr-model.md`` 8.8)."""
        std = torch.ones(condition_size(goal))
        std[INITIAL_VELOCITY] = fps
        return cls(torch.zeros_like(std), std, frozenset(dropped))

    def __call__(self, raw: Float[torch.Tensor, "batch size"]) -> Float[torch.Tensor, "batch size"]:
        """Scale a batch, on its own device."""
        vector = (raw - self.mean.to(raw.device)) / self.std.to(raw.device)
        for name in self.dropped & SLICES.keys():
            vector[:, SLICES[name]] = 0.0
        return vector
