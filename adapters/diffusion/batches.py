"""Steps that a batch of conditions takes around a network.

Bodies are put onto the skeleton that a model has learnt and motions back onto the person's; sequences of similar length
share a pass, so that little is computed for padding; each sequence draws its noise from its own seed, with NumPy, so
that it is the same on every device and in every batch.

Models of P&R or Nymeria know bodies with their own bone lengths. Models of HumanML3D know one skeleton only: conditions
are put onto it, goals are scaled with the root, and the motion is scaled back
(docs/specification/pr-model.md#data-and-features). A network predicts positions, so the lengths of its bones waver by
some per cent; with the option ``bones=initial``, which the study does not have, every bone keeps its predicted
direction and takes its length from the initial pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.contract import ConditionBatch, Motions
from prbench.geometry.skeleton import BONES, N_JOINTS, PARENTS
from prbench.randomness import sequence_generator
from prbench.representation import UniformSkeleton
from prbench.representation.features import N_FEATURES

_MOST_PADDING = 0.25  # of the shortest sequence of a part
_PARENTS, _CHILDREN = (list(ends) for ends in zip(*BONES, strict=True))
_SHORTEST = 1e-6  # metres; keeps the direction of a vanished bone, and its gradient, finite


def parts_of_similar_length(n_frames: Int[np.ndarray, " batch"], largest: int) -> list[Int[np.ndarray, " _"]]:
    """Row numbers in parts of at most ``largest``, shortest sequences first.

    A part ends early where the next sequence would make the shortest one carry a quarter of its length as padding.
    """
    parts: list[list[int]] = []
    # Stable, so that equal lengths keep their order and a run can be repeated.
    for row in np.argsort(n_frames, kind="stable").tolist():
        room = bool(parts) and len(parts[-1]) < largest
        if room and n_frames[row] <= (1 + _MOST_PADDING) * n_frames[parts[-1][0]]:
            parts[-1].append(row)
        else:
            parts.append([row])
    return [np.array(part) for part in parts]


class SequenceNoise:
    """Standard normal noise of B sequences, draw after draw.

    Args:
        noise_seed: One per sequence.
        n_frames: Frames of each sequence; padding is zero.
        device: Where the noise is wanted.
    """

    def __init__(
        self, noise_seed: Sequence[int], n_frames: Int[np.ndarray, " batch"], device: torch.device | str = "cpu"
    ) -> None:
        # One stream a sequence, drawn with NumPy: neither batch nor device changes a number.
        self._generators = [sequence_generator(seed) for seed in noise_seed]
        self._n_frames, self._device = n_frames, device

    def draw(self, columns: int = N_FEATURES) -> Float[torch.Tensor, "batch frames columns"]:
        """The next noise of every sequence; as long as the longest."""
        noise = np.zeros((len(self._n_frames), int(self._n_frames.max()), columns), dtype=np.float32)
        for row, (generator, n) in enumerate(zip(self._generators, self._n_frames, strict=True)):
            noise[row, :n] = generator.standard_normal((int(n), columns), dtype=np.float32)
        return torch.from_numpy(noise).to(self._device)


def start_noise(
    noise_seed: Sequence[int],
    n_frames: Int[np.ndarray, " batch"],
    device: torch.device | str = "cpu",
    *,
    columns: int = N_FEATURES,
) -> Float[torch.Tensor, "batch frames columns"]:
    """The noise that sampling starts from, and that noise optimisation starts with: the first draw of each sequence."""
    return SequenceNoise(noise_seed, n_frames, device).draw(columns)


@runtime_checkable
class _HasSkeleton(Protocol):
    """A model's configuration."""

    @property
    def uniform_skeleton(self) -> bool:
        """True if the model has learnt bodies that were rescaled to HumanML3D's skeleton."""
        ...


@dataclass(frozen=True)
class ModelBodies:
    """A batch as a model sees it."""

    batch: ConditionBatch
    skeleton: UniformSkeleton | None
    """The change of skeleton; None if there is none."""

    @classmethod
    def of(cls, batch: ConditionBatch, configuration: _HasSkeleton) -> ModelBodies:
        """The batch on the skeleton of the model.

        Without an initial pose (condition ``text``) the body is not known; then the motion keeps the model's size.
        """
        if not configuration.uniform_skeleton or batch.initial_joints is None:
            return cls(batch, None)
        skeleton = UniformSkeleton.of(batch.initial_joints)
        changed = {
            name: convert(getattr(batch, name))
            for name, convert in (
                ("initial_joints", skeleton.poses),
                ("previous_joints", skeleton.poses),
                ("goal_joints", skeleton.poses),
                ("goal_location", skeleton.locations),
            )
            if getattr(batch, name) is not None
        }
        return cls(replace(batch, **changed), skeleton)

    def own(self, joints: Float[np.ndarray, "batch frames 22 3"]) -> Float[np.ndarray, "batch frames 22 3"]:
        """Bring what the model has generated to the scale of the bodies, metres."""
        if self.skeleton is None:
            return joints
        return self.skeleton.own_scale(joints.reshape(len(joints), -1, 3)).reshape(joints.shape)


def bone_lengths(pose: Float[torch.Tensor, "*batch 22 3"]) -> Float[torch.Tensor, "*batch 21"]:
    """Lengths of the bones of a pose, metres, in the order of :data:`prbench.geometry.skeleton.BONES`."""
    return (pose[..., _CHILDREN, :] - pose[..., _PARENTS, :]).norm(dim=-1)


def with_bone_lengths(
    joints: Float[torch.Tensor, "batch frames 22 3"], lengths: Float[torch.Tensor, "batch 21"]
) -> Float[torch.Tensor, "batch frames 22 3"]:
    """Keep the directions of all bones, with other lengths; differentiable.

    The pelvis keeps its place over the floor, and the lowest joint its height: longer legs would sink into the floor.

    Args:
        joints: Metres, any frame.
        lengths: Of the bones of each sequence, metres.
    """
    bones = joints[..., _CHILDREN, :] - joints[..., _PARENTS, :]
    directions = bones / bones.norm(dim=-1, keepdim=True).clamp_min(_SHORTEST)
    # Positions are sums of bones along the way from the pelvis, which one product with the ancestry gives for all.
    offsets = directions * lengths[:, None, :, None]
    moved = joints[..., :1, :] + _ancestry(joints) @ offsets
    sunk = joints[..., 1].amin(dim=-1) - moved[..., 1].amin(dim=-1)
    return moved + sunk[..., None, None] * moved.new_tensor((0.0, 1.0, 0.0))


def on_own_bones(motions: Motions, batch: ConditionBatch) -> Motions:
    """The motions with the bone lengths of the initial pose in every frame."""
    lengths = bone_lengths(torch.as_tensor(batch.initial_joints, dtype=torch.float32))
    joints = with_bone_lengths(torch.as_tensor(motions.joints, dtype=torch.float32), lengths)
    return replace(motions, joints=joints.numpy())


def _ancestry(joints: torch.Tensor) -> Float[torch.Tensor, "22 21"]:
    """1 where a bone leads from the pelvis to a joint, else 0."""
    leads = torch.zeros(N_JOINTS, N_JOINTS - 1)
    for joint in range(1, N_JOINTS):  # parents come before their children
        leads[joint] = leads[PARENTS[joint]]
        leads[joint, joint - 1] = 1.0
    return leads.to(joints)
