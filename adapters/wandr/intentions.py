"""What a body intends: where its right wrist, pelvis and heading should go, and how soon.

Source: docs/specification/wandr.md#intention-features.
"""

from __future__ import annotations

import torch
from jaxtyping import Float

from prbench_adapters.kinematics.rotations import unit
from prbench_adapters.wandr.state import heading_of

INTENTION_SIZE = 9

_PELVIS_MOST = 2.0  # length of the pelvis intention towards goals far away
_SECONDS = 1e-5  # added to the remaining time
_ABOVE = 1e-6  # metres on the floor between pelvis and goal below which the goal has no direction


def intentions(
    yaw: Float[torch.Tensor, "*batch 3 3"],
    *,
    wrist: Float[torch.Tensor, "*batch 3"],
    pelvis: Float[torch.Tensor, "*batch 3"],
    goal: Float[torch.Tensor, "*batch 3"],
    frames_left: Float[torch.Tensor, "*batch 1"],
    fps: float,
    goal_heading: Float[torch.Tensor, "*batch 3"] | None = None,
) -> Float[torch.Tensor, "*batch 9"]:
    """Intentions of wrist, pelvis and heading, all seen from the body's yaw; they are never standardised.

    Args:
        yaw: Of the body (:func:`prbench_adapters.wandr.state.yaw_rotation`).
        wrist: Its right wrist, metres, Z up.
        pelvis: Likewise.
        goal: Where the wrist is to be.
        frames_left: Frames until then.
        fps: Frames per second.
        goal_heading: Unit vector that the body should face then; towards the goal by default.
    """
    heading = heading_of(yaw)
    if goal_heading is None:
        to_goal = (goal - pelvis) * goal.new_tensor((1.0, 1.0, 0.0))
        above = to_goal.norm(dim=-1, keepdim=True) < _ABOVE
        goal_heading = torch.where(above, heading, unit(to_goal))
    velocity = _turned(yaw, goal - wrist) / (frames_left / fps + _SECONDS)
    approach = _turned(yaw, goal - pelvis)
    distance = approach.norm(dim=-1, keepdim=True)
    approach = _PELVIS_MOST * (1 - torch.exp(-distance)) * unit(approach) * goal.new_tensor((1.0, 1.0, 0.0))
    return torch.cat((velocity, approach, _turned(yaw, goal_heading - heading)), -1)


def _turned(yaw: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """World vectors as the yaw frame sees them."""
    return (yaw.mT @ vectors[..., None])[..., 0]
