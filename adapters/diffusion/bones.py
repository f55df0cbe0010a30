"""Motions on the skeleton of their first pose: every bone keeps its predicted direction and takes its own length.

The network predicts positions, so the lengths of its bones waver by some per cent. The initial pose is given, and with
it every bone length; the study does not use them, so this is an option (``bones=initial``).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float

from prbench.contract import ConditionBatch, Motions
from prbench.skeleton import BONES, N_JOINTS, PARENTS

_PARENTS, _CHILDREN = (list(ends) for ends in zip(*BONES, strict=True))
_SHORTEST = 1e-6  # metres; keeps the direction of a vanished bone, and its gradient, finite


def bone_lengths(pose: Float[torch.Tensor, "*batch 22 3"]) -> Float[torch.Tensor, "*batch 21"]:
    """Lengths of the bones of a pose, metres, in the order of :data:`prbench.skeleton.BONES`."""
    return (pose[..., _CHILDREN, :] - pose[..., _PARENTS, :]).norm(dim=-1)


def with_bone_lengths(
    joints: Float[torch.Tensor, "batch frames 22 3"], lengths: Float[torch.Tensor, "batch 21"]
) -> Float[torch.Tensor, "batch frames 22 3"]:
    """The same pelvis and bone directions with other bone lengths; differentiable.

    Args:
        joints: Metres, any frame.
        lengths: Of the bones of each sequence, metres.
    """
    bones = joints[..., _CHILDREN, :] - joints[..., _PARENTS, :]
    directions = bones / bones.norm(dim=-1, keepdim=True).clamp_min(_SHORTEST)
    offsets = directions * lengths[:, None, :, None]
    return joints[..., :1, :] + _ancestry(joints) @ offsets


def on_own_bones(motions: Motions, batch: ConditionBatch) -> Motions:
    """The motions with the bone lengths of the initial pose in every frame."""
    lengths = bone_lengths(torch.as_tensor(batch.initial_joints, dtype=torch.float32))
    joints = with_bone_lengths(torch.as_tensor(motions.joints, dtype=torch.float32), lengths)
    return replace(motions, joints=joints.numpy())


def _ancestry(joints: torch.Tensor) -> Float[torch.Tensor, "22 21"]:
    """Which bones lead from the pelvis to each joint: 1 or 0."""
    leads = torch.zeros(N_JOINTS, N_JOINTS - 1)
    for joint in range(1, N_JOINTS):  # parents come before their children
        leads[joint] = leads[PARENTS[joint]]
        leads[joint, joint - 1] = 1.0
    return leads.to(joints)
