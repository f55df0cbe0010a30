"""Body states, the changes between them, and how both are seen without the yaw.

Source: docs/specification/wandr.md#state-and-delta.

World with Z up, metres; a body of yaw 0 has its left side on +x and faces -y. Rotations are six numbers, by rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Float

from prbench.skeleton import N_JOINTS, Joint
from prbench_adapters.kinematics.rotations import matrices_of, orthonormalised, rows_of, unit
from prbench_adapters.kinematics.skeleton import fitted_rotations, forward_kinematics

DELTA_SIZE = 3 + 6 * N_JOINTS
"""Numbers of a change: step of the pelvis, turn of the root, turns of the 21 other joints."""
SEEN_SIZE = 1 + 6 * N_JOINTS
"""Numbers of a state without its yaw and its place on the floor."""
TRANSLATION, ROOT, JOINTS = slice(0, 3), slice(3, 9), slice(9, DELTA_SIZE)
"""Parts of a change."""

_LYING = 0.1  # length of the horizontal part of the left axis below which the body lies on its side (6 degrees)


@dataclass(frozen=True)
class BodyState:
    """Where a body is and how it is bent."""

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
        """That of the root (:func:`yaw_rotation`)."""
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
    left, front = root[..., :2, 0].detach(), root[..., :2, 2].detach()
    lying = left.norm(dim=-1, keepdim=True) < _LYING
    across = torch.where(lying, torch.stack((-front[..., 1], front[..., 0]), -1), left)
    zero = torch.zeros_like(across[..., :1])
    cos, sin, _ = unit(torch.cat((across, zero), -1)).split(1, -1)
    return torch.cat((cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1), -1).unflatten(-1, (3, 3))


def heading_of(yaw: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 3"]:
    """The horizontal direction that a body of this yaw faces."""
    return -yaw[..., :, 1]
