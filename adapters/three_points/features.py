"""What a network sees of head and wrists, 54 values a frame, and the kinematics that turn its answer into joints.

Source: docs/specification/three-points.md#avatarposer. The values of a frame are 18 vectors: two columns of each
device's rotation, two of each rotation's change in the device's own frame, three positions, three changes of position;
in each group head, left wrist, right wrist.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prbench.geometry.skeleton import PARENTS, Joint, rotation_matrices
from prbench_adapters.kinematics import matrices_of, rows_of
from prbench_adapters.tensors import TensorRecord

N_VALUES = 54

Rows = Float[Tensor, "frames 54"]
Windows = Float[Tensor, "windows length 54"]
Local = Float[Tensor, "*batch joints 3 3"]
Bones = Float[Tensor, "*#batch joints 3"]
Joints = Float[Tensor, "*batch joints 3"]


@dataclass(frozen=True)
class TrackWindows(TensorRecord):
    """Windows of tracks with the bodies to learn, each in the frame of its last head (:func:`in_head_frame`).

    Attributes:
        features: Values of head and wrists, 0 where not measured or hidden.
        rotations: Two columns of each joint's rotation in its parent, the root's in the window's frame.
        head: Position of the head joint, metres.
        offsets: Each joint's offset from its parent at rest, metres.
    """

    features: Windows
    rotations: Float[Tensor, "windows length 22 6"]
    head: Float[Tensor, "windows length 3"]
    offsets: Float[Tensor, "windows 22 3"]


def columns_of(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 6"]:
    """Return the first two **columns**, one after the other."""
    return rows_of(matrices.mT)


def matrices_of_columns(columns: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """Return rotation matrices of two columns that need not be orthonormal (Gram-Schmidt, the first one leads)."""
    return matrices_of(columns).mT


def frame_values(position: Float[Tensor, "n 3 3"], rotation: Float[Tensor, "n 3 3 3"]) -> Float[Tensor, "later 54"]:
    """Return AvatarPoser's values of every frame but the first, which has no change.

    Args:
        position: Positions of head, left and right wrist, world, metres.
        rotation: World from device.
    """
    change = rotation[:-1].mT @ rotation[1:]
    groups = (columns_of(rotation[1:]), columns_of(change), position[1:], position[1:] - position[:-1])
    return torch.cat([group.flatten(1) for group in groups], dim=1)


def track_values(
    position: Float[np.ndarray, "frames 3 3"],
    rotation: Float[np.ndarray, "frames 3 4"],
    valid: Bool[np.ndarray, "frames 3"],
    rotation_valid: Bool[np.ndarray, "frames 3"],
    fps: float,
) -> Rows:
    """Return the values of every frame of a track as our networks take them, NaN where something was not measured.

    Changes are those of a second (of rotations less the identity), so that they are as large as the rest and alike at
    every rate.

    Args:
        position: Positions of head, left and right wrist, world with its floor at height 0, metres; anything where
            not valid.
        rotation: World from device, w x y z; anything where not valid.
        valid: Devices whose position is known.
        rotation_valid: Devices whose rotation is known, where their position is.
        fps: Frames per second.
    """
    matrices = np.where((valid & rotation_valid)[..., None, None], rotation_matrices(rotation), np.nan)
    places = np.where(valid[..., None], position, np.nan)
    # What was before the first frame is not known.
    values = frame_values(*(torch.from_numpy(np.concatenate([each[:1] * np.nan, each])) for each in (places, matrices)))
    still = columns_of(torch.eye(3).to(values)).repeat(3)
    changes = [(values[:, 18:36] - still) * fps, values[:, 36:45], values[:, 45:] * fps]
    return torch.cat([values[:, :18], *changes], dim=1).float()


def device_mask(groups: Sequence[Bool[Tensor, "*batch 3"]]) -> Bool[Tensor, "*batch 54"]:
    """Return the values of a frame that are known, given the devices of which each group of values is."""
    return torch.cat([mask.repeat_interleave(size, dim=-1) for mask, size in zip(groups, (6, 6, 3, 3))], dim=-1)


def windows_ending_at(rows: Rows, ends: Int[Tensor, " windows"], length: int) -> Windows:
    """Return the rows up to each of some frames; NaN before the track's first frame, as nothing was measured."""
    places = ends[:, None] + torch.arange(1 - length, 1)
    return torch.where((places >= 0)[:, :, None], rows[places.clamp_min(0)], torch.nan)


def in_head_frame(windows: Windows) -> tuple[Windows, Float[Tensor, "windows 3 3"], Float[Tensor, "windows 3"]]:
    """Move windows to the frame of their last head: its heading is +Z, its place on the floor the origin.

    Args:
        windows: World, Y up, NaN where not measured.

    Returns:
        Windows with 0 where not measured, world from window (rotations), and the window's origin in the world; these
        two are NaN without a last head.
    """
    vectors = windows.unflatten(-1, (18, 3))
    left, up = vectors[:, -1, 0], vectors[:, -1, 1]
    forward = torch.linalg.cross(left, up)
    # The turn about +Y nearest to the head's rotation, which is one even where somebody looks straight down.
    yaw = torch.atan2(forward[:, 0] - left[:, 2], left[:, 0] + forward[:, 2])
    cosine, sine = yaw.cos(), yaw.sin()
    zero = torch.zeros_like(yaw)
    turn = torch.stack([cosine, zero, sine, zero, zero + 1.0, zero, -sine, zero, cosine], dim=-1).unflatten(-1, (3, 3))
    origin = vectors[:, -1, 12] * windows.new_tensor([1.0, 0.0, 1.0])
    # A row vector times a rotation is turned back by it. Changes of rotation are in the device's frame already.
    positions = (vectors[:, :, 12:15] - origin[:, None, None]) @ turn[:, None]
    parts = [vectors[:, :, :6] @ turn[:, None], vectors[:, :, 6:12], positions, vectors[:, :, 15:] @ turn[:, None]]
    return torch.cat(parts, dim=2).flatten(2).nan_to_num(0.0), turn, origin


def kinematic_joints(local: Local, offsets: Bones, parents: Sequence[int] = PARENTS) -> Joints:
    """Joints of a skeleton whose joints turn in their parents, with the root at the origin.

    Args:
        local: Rotation of each joint in its parent, that of joint 0 in the world.
        offsets: Place of each joint in its parent's frame, metres; that of joint 0 is not used.
        parents: Parent of each joint, parents before children.
    """
    world = [local[..., 0, :, :]]
    joints = [torch.zeros_like(local[..., 0, :, 0])]
    for joint in range(1, len(parents)):
        above = world[parents[joint]]
        joints.append(joints[parents[joint]] + (above @ offsets[..., joint, :, None])[..., 0])
        world.append(above @ local[..., joint, :, :])
    return torch.stack(joints, dim=-2)


def joints_under_head(local: Local, offsets: Bones, head: Float[Tensor, "*batch 3"]) -> Joints:
    """Joints of a body whose head joint stands where the head was measured: nothing learns where the root is."""
    joints = kinematic_joints(local, offsets)
    return joints - joints[..., Joint.HEAD : Joint.HEAD + 1, :] + head[..., None, :]
