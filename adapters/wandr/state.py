"""Body states, the changes between them, and how both are seen without the yaw.

Source: docs/specification/wandr.md#state-and-delta.

World with Z up, metres; a body of yaw 0 has its left side on +x and faces -y. Rotations are six numbers, by rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench_adapters.kinematics import (
    fitted_rotations,
    forward_kinematics,
    matrices_of,
    orthonormalised,
    rows_of,
    unit,
)

DELTA_SIZE = 3 + 6 * N_JOINTS
"""Numbers of a change: step of the pelvis, turn of the root, turns of the 21 other joints."""
SEEN_SIZE = 1 + 6 * N_JOINTS
"""Numbers of a state without its yaw and its place on the floor."""
TRANSLATION = slice(0, 3)
ROOT = slice(3, 9)
JOINTS = slice(9, DELTA_SIZE)
"""Parts of a change."""

_LYING = 0.1  # length of the horizontal part of the left axis below which the body lies on its side (6 degrees)
INTENTION_SIZE = 9
_PELVIS_MOST = 2.0  # length of the pelvis intention towards goals far away
_SECONDS = 1e-5  # added to the remaining time
_ABOVE = 1e-6  # metres on the floor between pelvis and goal below which the goal has no direction


@dataclass(frozen=True)
class BodyState:
    """Place and pose of a body."""

    pelvis: Float[torch.Tensor, "*batch 3"]
    rotations: Float[torch.Tensor, "*batch 22 3 3"]
    """The root's orientation, and of each other joint the rotation relative to the one before."""

    @classmethod
    def fitted(cls, joints: Float[torch.Tensor, "*batch 22 3"]) -> BodyState:
        """The state of given joint positions; exact in every bone's direction."""
        return cls(joints[..., Joint.PELVIS, :], fitted_rotations(joints))

    def __getitem__(self, index: Any) -> BodyState:
        """The states at these places of the leading axes."""
        return BodyState(self.pelvis[index], self.rotations[index])

    def joints(self, offsets: Float[torch.Tensor, "... 22 3"]) -> Float[torch.Tensor, "*batch 22 3"]:
        """Joint positions of a skeleton with these rest offsets, metres."""
        return forward_kinematics(self.rotations, self.pelvis, offsets)

    @cached_property
    def yaw(self) -> Float[torch.Tensor, "*batch 3 3"]:
        """Yaw of the root (:func:`yaw_rotation`)."""
        return yaw_rotation(self.rotations[..., 0, :, :])

    def seen(self) -> Float[torch.Tensor, "*batch 133"]:
        """Height, orientation without yaw, joint rotations: x(s)."""
        root = self.yaw.mT @ self.rotations[..., 0, :, :]
        return torch.cat((self.pelvis[..., 2:], rows_of(root), rows_of(self.rotations[..., 1:, :, :]).flatten(-2)), -1)

    def changed(self, delta: Float[torch.Tensor, "*batch 135"]) -> BodyState:
        """The state after a change; whatever the numbers are, rotations stay rotations."""
        step = self.yaw @ delta[..., TRANSLATION, None]
        turns = matrices_of(delta[..., 3:].unflatten(-1, (N_JOINTS, 6)))
        return BodyState(self.pelvis + step[..., 0], orthonormalised(self.rotations @ turns))

    def delta_to(self, following: BodyState) -> Float[torch.Tensor, "*batch 135"]:
        """The change that leads to another state: :meth:`changed` undoes it."""
        step = self.yaw.mT @ (following.pelvis - self.pelvis)[..., None]
        turns = self.rotations.mT @ following.rotations
        return torch.cat((step[..., 0], rows_of(turns).flatten(-2)), -1)


def clean_delta(delta: Float[torch.Tensor, "*batch 135"]) -> Float[torch.Tensor, "*batch 135"]:
    """A predicted change as it acts: its turns made rotations."""
    turns = rows_of(matrices_of(delta[..., 3:].unflatten(-1, (N_JOINTS, 6))))
    return torch.cat((delta[..., TRANSLATION], turns.flatten(-2)), -1)


def yaw_rotation(root: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 3 3"]:
    """The rotation about z that is the yaw of an orientation, without gradients.

    It is the first angle of the intrinsic ZYX Euler angles, which is the direction of the body's left axis. For a body
    that lies on its side that angle means nothing; there the facing axis decides. The original computes the yaw outside
    of the graph, which keeps the training on its own output stable.
    """
    left = root[..., :2, 0].detach()
    front = root[..., :2, 2].detach()
    # A left axis that points up or down has no direction on the floor.
    lying = left.norm(dim=-1, keepdim=True) < _LYING
    across = torch.where(lying, torch.stack((-front[..., 1], front[..., 0]), -1), left)
    zero = torch.zeros_like(across[..., :1])
    cos, sin, _ = unit(torch.cat((across, zero), -1)).split(1, -1)
    return torch.cat((cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1), -1).unflatten(-1, (3, 3))


def heading_of(yaw: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 3"]:
    """The horizontal direction that a body of this yaw faces."""
    return -yaw[..., :, 1]


def intentions(
    yaw: Float[torch.Tensor, "*batch 3 3"],
    *,
    wrist: Float[torch.Tensor, "*batch 3"],
    pelvis: Float[torch.Tensor, "*batch 3"],
    goal: Float[torch.Tensor, "*batch 3"],
    frames_left: Float[torch.Tensor, "*batch 1"],
    fps: float,
    goal_heading: Float[torch.Tensor, "*batch 3"] | None = None,
    most_speed: float = math.inf,
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
        most_speed: Longest intention of the wrist, metres a second; a longer one keeps its direction.
    """
    heading = heading_of(yaw)
    if goal_heading is None:
        to_goal = (goal - pelvis) * goal.new_tensor((1.0, 1.0, 0.0))
        above = to_goal.norm(dim=-1, keepdim=True) < _ABOVE
        goal_heading = torch.where(above, heading, unit(to_goal))
    # The velocity that would bring the wrist to the goal just in time.
    velocity = _turned(yaw, goal - wrist) / (frames_left / fps + _SECONDS)
    if most_speed < math.inf:
        speed = velocity.norm(dim=-1, keepdim=True)
        velocity = velocity * (most_speed / speed.clamp_min(most_speed))
    approach = _turned(yaw, goal - pelvis)
    distance = approach.norm(dim=-1, keepdim=True)
    # Saturates with the distance: a goal ten metres away asks for no faster walk than one four metres away.
    approach = _PELVIS_MOST * (1 - torch.exp(-distance)) * unit(approach) * goal.new_tensor((1.0, 1.0, 0.0))
    return torch.cat((velocity, approach, _turned(yaw, goal_heading - heading)), -1)


def _turned(yaw: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """World vectors as the yaw frame sees them."""
    return (yaw.mT @ vectors[..., None])[..., 0]
