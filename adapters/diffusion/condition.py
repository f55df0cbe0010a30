"""Conditions as a denoiser takes them: encoded text, and the vector p of initial pose, initial velocity and goal.

docs/specification/pr-model.md#task-and-conditions and docs/specification/pr-model.md#network (*Prime and Reach*,
section 4.1). Everything is given in the canonical frame of the first pose, in metres; velocities are in metres per
second. :attr:`~prbench_adapters.diffusion.configuration.DenoiserConfiguration.condition_parts` tells where each part
stands in the vector.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from jaxtyping import Bool, Float

from prbench.contract import ConditionBatch
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.goal_frame import seen_condition
from prbench_adapters.training.items import Goal, MotionBatch


@dataclass(frozen=True)
class EncodedCondition:
    """Conditions of B motions."""

    text: Float[torch.Tensor, "batch tokens dimension"]
    """Vectors of the frozen text encoder, one per word piece."""
    padding: Bool[torch.Tensor, "batch tokens"]
    """True where a row has no word piece. The first token of a row always counts, so that no row is without any."""
    vector: Float[torch.Tensor, "batch size"] | None = None
    """Initial pose, initial velocity and goal, scaled (docs/specification/pr-model.md#network); None without a goal."""
    given: Float[torch.Tensor, "batch raw"] | None = None
    """The same as it was given (:func:`raw_condition`): what goal-frame features are measured from."""

    def __len__(self) -> int:
        return len(self.text)

    def without_text(self) -> EncodedCondition:
        """The unconditional half of guidance: zeros for the text vectors; its padding and the vector stay."""
        return replace(self, text=torch.zeros_like(self.text))

    def rows(self, index: slice | Sequence[int] | torch.Tensor) -> EncodedCondition:
        """Some of the motions, in the order of ``index``."""
        return self._each(lambda values: values[index])

    def then(self, other: EncodedCondition) -> EncodedCondition:
        """These motions and those of ``other`` as one batch; both have the same number of tokens.

        Raises:
            ValueError: if only one of the two has a vector.
        """
        if (self.vector is None) is not (other.vector is None):
            raise ValueError("conditions with and without a vector cannot share a batch")
        joined: dict[str, Any] = {}
        for field in fields(self):
            ours = getattr(self, field.name)
            joined[field.name] = None if ours is None else torch.cat([ours, getattr(other, field.name)])
        return EncodedCondition(**joined)

    def to(self, device: torch.device | str) -> EncodedCondition:
        """Move the conditions to another device."""
        return self._each(lambda values: values.to(device))

    def _each(self, change: Callable[[torch.Tensor], torch.Tensor]) -> EncodedCondition:
        changed: dict[str, Any] = {}
        for field in fields(self):
            ours = getattr(self, field.name)
            changed[field.name] = None if ours is None else change(ours)
        return EncodedCondition(**changed)


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
    # Per second, so that tables of another frame rate mean the same by the same number.
    velocity = (initial_joints - previous_joints) * fps
    return torch.cat([part.flatten(1) for part in (initial_joints, velocity, goal)], dim=1).float()


def raw_condition_of_items(batch: MotionBatch, goal: Goal) -> Float[torch.Tensor, "batch size"]:
    """:func:`raw_condition` of motions that are trained on.

    Args:
        batch: The motions.
        goal: ``pose`` or ``location``.
    """
    target = batch.goal_joints if goal == "pose" else batch.goal_location
    return raw_condition(batch.initial_joints, batch.previous_joints, target, batch.fps)


def raw_condition_of(
    batch: ConditionBatch, configuration: DenoiserConfiguration
) -> Float[torch.Tensor, "batch size"] | None:
    """:func:`raw_condition` of what a method is given; None for a model without a goal.

    Raises:
        ValueError: if the batch holds no goal of the model's kind.
    """
    if configuration.goal == "none":
        return None
    target = batch.goal_joints if configuration.goal == "pose" else batch.goal_location
    if target is None or batch.initial_joints is None or batch.previous_joints is None:
        raise ValueError(f"a model of goals of kind '{configuration.goal}' cannot use '{batch.condition.value}'")
    initial, previous, goal = (
        torch.as_tensor(part, dtype=torch.float32) for part in (batch.initial_joints, batch.previous_joints, target)
    )
    return raw_condition(initial, previous, goal, batch.fps)


@dataclass(frozen=True)
class ConditionScaling:
    """Scales a raw vector for the network: ``(raw - mean) / std``, dropped conditions zero.

    With goal-frame features the raw vector is first seen from the goal (:func:`.goal_frame.seen_condition`).
    """

    mean: Float[torch.Tensor, " size"]
    std: Float[torch.Tensor, " size"]
    kept: Float[torch.Tensor, " size"]
    """0 for conditions that the model never sees, in training and test alike (table 3), else 1."""
    from_goal: bool = False
    """True with goal-frame features."""

    @classmethod
    def of(
        cls,
        configuration: DenoiserConfiguration,
        mean: Float[torch.Tensor, " size"],
        std: Float[torch.Tensor, " size"],
    ) -> ConditionScaling:
        """Scale by the statistics of a training split, or by none if the configuration says so.

        ``condition_scaling = "none"`` is the literal reading of the study: metres, and metres per frame for the
        velocity (docs/specification/pr-model.md#gaps-in-the-study, gap 8).
        """
        if configuration.features == "goal-frame":
            return cls(mean, std, torch.ones_like(mean), from_goal=True)
        parts = configuration.condition_parts
        kept = torch.ones_like(mean)
        if configuration.condition_scaling == "none":
            mean = torch.zeros_like(mean)
            std = torch.ones_like(std)
            # Dividing metres per second by frames per second gives metres per frame.
            std[parts["initial_velocity"]] = configuration.fps
        for name, part in parts.items():
            if name in configuration.dropped:
                kept[part] = 0.0
        return cls(mean, std, kept)

    def __call__(self, raw: Float[torch.Tensor, "batch raw"]) -> Float[torch.Tensor, "batch size"]:
        """Scale a batch, on its own device."""
        mean, std, kept = (values.to(raw.device) for values in (self.mean, self.std, self.kept))
        seen = seen_condition(raw) if self.from_goal else raw
        return (seen - mean) / std * kept
