"""From a batch of conditions to what the two stages of sampling must meet.

Source: docs/specification/gmd.md#for-the-benchmark.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prbench.skeleton import Joint
from prbench_adapters.gmd.features import N_POSE, ROOT_XZ, FeatureSpace, half_turn_of, pose_columns
from prbench_adapters.gmd.sampling import Imputed, RootGoal

Keyframes = Literal["root", "pose"]
"""What is imputed of the first and the last frame: the pelvis on the ground, or in the second stage the whole pose."""


@dataclass(frozen=True)
class Ends:
    """First and last frame of B motions, canonical frame, metres."""

    first: Float[Tensor, "batch 22 3"]
    last: Float[Tensor, "batch 22 3"]
    n_frames: Int[Tensor, " batch"]

    def valid(self) -> Bool[Tensor, "batch frames"]:
        """Which frames there are."""
        return torch.arange(int(self.n_frames.max()), device=self.first.device) < self.n_frames[:, None]

    def root_keyframes(self) -> RootGoal:
        """The pelvis on the ground in the first and in the last frame."""
        frame = torch.arange(int(self.n_frames.max()), device=self.first.device)
        is_last = frame == self.n_frames[:, None] - 1
        xz = torch.where(is_last[..., None], _ground(self.last), _ground(self.first))
        return RootGoal(xz, is_last | (frame == 0))

    def impute_poses(self, imputed: Imputed, space: FeatureSpace) -> Imputed:
        """The same with root and joint positions of both frames; the goal's heading is that of its own joints."""
        unturned = torch.zeros(len(self.first), device=self.first.device)
        values, where = imputed.values.clone(), imputed.where.clone()
        row = torch.arange(len(self.first), device=self.first.device)
        for pose, half_turn, frame in (
            (self.last, half_turn_of(self.last), self.n_frames - 1),
            (self.first, unturned, torch.zeros_like(self.n_frames)),
        ):
            values[row, frame, :N_POSE] = space.standardised(pose_columns(pose, half_turn))
            where[row, frame, :N_POSE] = True
        return Imputed(values, where)


def imputed_root(goal: RootGoal, space: FeatureSpace, columns: int) -> Imputed:
    """The root of the wanted frames as standardised columns."""
    values = goal.xz.new_zeros(*goal.wanted.shape, columns)
    where = torch.zeros_like(values, dtype=torch.bool)
    values[..., ROOT_XZ] = (goal.xz - space.mean[ROOT_XZ]) / space.std[ROOT_XZ]
    where[..., ROOT_XZ] = goal.wanted[..., None]
    return Imputed(values, where)


def _ground(pose: Float[Tensor, "batch 22 3"]) -> Float[Tensor, "batch 1 2"]:
    return pose[:, None, Joint.PELVIS, ::2]
