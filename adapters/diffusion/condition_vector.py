"""The vector p is made of: initial pose, initial velocity and goal, scaled, with dropped conditions as zeros.

docs/specification/pr-model.md#task-and-conditions and docs/specification/pr-model.md#network (*Prime and Reach*,
section 4.1). Everything is given in the canonical frame of the first pose, in metres; velocities are in metres per
second. Where each part stands in the vector says
:attr:`prbench_adapters.diffusion.configuration.DenoiserConfiguration.condition_parts`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float

from prbench.contract import ConditionBatch
from prbench_adapters.diffusion.configuration import DenoiserConfiguration


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
    """How a raw vector becomes what the network sees: ``(raw - mean) / std``, dropped conditions zero."""

    mean: Float[torch.Tensor, " size"]
    std: Float[torch.Tensor, " size"]
    kept: Float[torch.Tensor, " size"]
    """0 for conditions that the model never sees, in training and test alike (table 3), else 1."""

    @classmethod
    def of(
        cls,
        configuration: DenoiserConfiguration,
        mean: Float[torch.Tensor, " size"],
        std: Float[torch.Tensor, " size"],
    ) -> ConditionScaling:
        """With the statistics of a training split, or none if the configuration says so.

        ``condition_scaling = "none"`` is the literal reading of the study: metres, and metres per frame for the
        velocity (docs/specification/pr-model.md#gaps-in-the-study, gap 8).
        """
        parts, kept = configuration.condition_parts, torch.ones_like(mean)
        if configuration.condition_scaling == "none":
            mean, std = torch.zeros_like(mean), torch.ones_like(std)
            std[parts["initial_velocity"]] = configuration.fps
        for name, part in parts.items():
            if name in configuration.dropped:
                kept[part] = 0.0
        return cls(mean, std, kept)

    def __call__(self, raw: Float[torch.Tensor, "batch size"]) -> Float[torch.Tensor, "batch size"]:
        """Scale a batch, on its own device."""
        mean, std, kept = (values.to(raw.device) for values in (self.mean, self.std, self.kept))
        return (raw - mean) / std * kept
