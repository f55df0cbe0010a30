"""Joint positions as rotations and back, for the methods that were made for body-model parameters (DART, WANDR).

Source: docs/specification/humanml3d.md#forward-conversion, step 7. Everything is differentiable.

The fit is analytical and exact: every bone keeps its direction, whatever its length. It differs from that of HumanML3D
in three points, so that a method may add small rotations to it frame by frame: the root has a full orientation (from
hips and lowest spine joint; there it is a heading), each rotation is relative to the bone before in the tree, so that
none but the root's changes when the body turns or leans, and the rest pose is a T, because arms do point straight up,
where a rest pose with hanging arms has its singularity.

The rotation of joint j turns the bone that *ends* in j. Twist about a bone moves no joint, so none is fitted.

The worlds of both methods have Z up; changing between them and Y up rounds nothing. A standing body that faces +Z (Y
up), its left side on +X, comes to face +y with its right side on +x in DART's world, and to face -y with its left side
on +x in WANDR's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, PARENTS, TOES, Joint

_SHORTEST = 1e-12  # of a vector that is made a unit vector; keeps zero vectors, and their gradients, finite
_OPPOSITE = 1e-6  # length of the sum of two unit vectors below which they count as opposite
_ABOVE_FLOOR = 0.02  # metres; the lower toe of people is never higher than 0.018
_NO_HEADING = 1e-3  # sine between hips and spine below which the shoulders say where left is
_X = (1.0, 0.0, 0.0)
_Y = (0.0, 1.0, 0.0)
_Z = (0.0, 0.0, 1.0)
# Directions of the bones at rest, by the joint in which they end: body frame, x left, y up, z to the front.
_REST = {
    _X: (Joint.LEFT_HIP, Joint.LEFT_COLLAR, Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST),
    _Y: (Joint.SPINE1, Joint.SPINE2, Joint.SPINE3, Joint.NECK),
    _Z: (Joint.LEFT_FOOT, Joint.RIGHT_FOOT, Joint.HEAD),
    (-1.0, 0.0, 0.0): (
        Joint.RIGHT_HIP, Joint.RIGHT_COLLAR, Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST,
    ),
    (0.0, -1.0, 0.0): (Joint.LEFT_KNEE, Joint.RIGHT_KNEE, Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE),
}  # fmt: skip


@dataclass(frozen=True)
class World:
    """A world with Z up, by the axes (0, 1, 2) that its points have in the world with Y up, and their signs."""

    axes: tuple[int, int, int]
    signs: tuple[float, float, float]

    def from_y_up(self, vectors: Float[torch.Tensor, "*batch 3"]) -> Float[torch.Tensor, "*batch 3"]:
        """Points or directions given with Y up."""
        return vectors[..., self.axes] * vectors.new_tensor(self.signs)

    def to_y_up(self, vectors: Float[torch.Tensor, "*batch 3"]) -> Float[torch.Tensor, "*batch 3"]:
        """Return the inverse of :meth:`from_y_up`."""
        back = tuple(self.axes.index(axis) for axis in range(3))
        return vectors[..., back] * vectors.new_tensor([self.signs[place] for place in back])


# docs/specification/dart.md#noise-optimisation: (x, y, z) with Y up is (-x, z, y) here, and the other way round.
DART = World(axes=(0, 2, 1), signs=(-1.0, 1.0, 1.0))
# docs/specification/wandr.md#inference: (x, y, z) here is (x, z, -y) with Y up.
WANDR = World(axes=(0, 2, 1), signs=(1.0, -1.0, 1.0))


def fitted_rotations(joints: Float[torch.Tensor, "*batch 22 3"]) -> Float[torch.Tensor, "*batch 22 3 3"]:
    """Rotations that give every bone its direction.

    Args:
        joints: Any world, metres. Hips, shoulders and spine must not all lie on one line.

    Returns:
        The root's orientation (world from body), and for each other joint the rotation of the bone that ends in it,
        relative to the bone before.
    """
    tree = _Tree(joints.dtype, joints.device)
    world = [root_orientation(joints)[..., None, :, :]]
    local = list(world)
    bones = unit(joints[..., 1:, :] - joints[..., PARENTS[1:], :])
    for level, parents in tree.levels:
        before = world[-1].index_select(-3, parents)
        seen = (before.mT @ bones.index_select(-2, level - 1)[..., None])[..., 0]
        # The rotations by the smallest angle that turn fixed axes onto directions.
        axes = tree.rest[level]
        between = seen + axes
        opposite = between.square().sum(-1, keepdim=True) < _OPPOSITE**2
        midway = unit(torch.where(opposite, tree.half_turns[level], between))
        turned = 2 * midway[..., :, None] * midway[..., None, :] - torch.eye(3).to(midway)
        local.append(turned * (2 * axes.abs() - 1)[:, None, :])
        world.append(before @ local[-1])
    return torch.cat(local, -3).index_select(-3, tree.order)


def root_orientation(joints: Float[torch.Tensor, "*batch 22 3"]) -> Float[torch.Tensor, "*batch 3 3"]:
    """World from body: left along the hips, up along the lowest spine bone as far as orthogonal to that.

    Where the hips lie along the spine, which no body does, the shoulders stand in for them.
    """
    up = unit(joints[..., Joint.SPINE1, :] - joints[..., Joint.PELVIS, :])
    hips = unit(joints[..., Joint.LEFT_HIP, :] - joints[..., Joint.RIGHT_HIP, :])
    shoulders = unit(joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :])
    sine = torch.linalg.cross(hips, up).square().sum(-1, keepdim=True)
    # A cross product of parallel vectors has no direction, only rounding.
    left = torch.where(sine > _NO_HEADING**2, hips, shoulders)
    front = unit(torch.linalg.cross(left, up))
    return torch.stack((left, torch.linalg.cross(front, left), front), -1)


def unit(vectors: Float[torch.Tensor, "*batch 3"]) -> Float[torch.Tensor, "*batch 3"]:
    """Return unit vectors; a zero vector stays zero and has no gradient of NaN."""
    square = vectors.square().sum(-1, keepdim=True)
    return vectors * torch.where(square > _SHORTEST**2, square, 1.0).rsqrt()


def forward_kinematics(
    rotations: Float[torch.Tensor, "*batch 22 3 3"],
    pelvis: Float[torch.Tensor, "*batch 3"],
    offsets: Float[torch.Tensor, "... 22 3"],
) -> Float[torch.Tensor, "*batch 22 3"]:
    """Joints of a skeleton moved by rotations; the world is that of pelvis and root.

    Args:
        rotations: Rotations such as :func:`fitted_rotations` returns.
        pelvis: Its position, metres.
        offsets: Offset of each joint from its parent at rest (:func:`rest_offsets`), metres; broadcasts against
            ``batch``.
    """
    tree = _Tree(rotations.dtype, rotations.device)
    world = [rotations[..., :1, :, :]]
    joints = [pelvis[..., None, :]]
    for level, parents in tree.levels:
        world.append(world[-1].index_select(-3, parents) @ rotations.index_select(-3, level))
        bones = (world[-1] @ offsets.index_select(-2, level)[..., None])[..., 0]
        joints.append(joints[-1].index_select(-2, parents) + bones)
    return torch.cat(joints, -2).index_select(-2, tree.order)


def rest_offsets(joints: Float[torch.Tensor, "*batch 22 3"]) -> Float[torch.Tensor, "*batch 22 3"]:
    """Return the skeleton at rest with the bone lengths of a pose: offset of each joint from its parent, metres."""
    lengths = (joints[..., 1:, :] - joints[..., PARENTS[1:], :]).norm(dim=-1, keepdim=True)
    return torch.nn.functional.pad(lengths, (0, 0, 1, 0)) * _Tree(joints.dtype, joints.device).rest


def to_floor(
    joints: Float[torch.Tensor, "*batch 22 3"], first: Float[torch.Tensor, "... 22 3"]
) -> Float[torch.Tensor, "*batch 3"]:
    """Return the move up or down that brings the lower toe back to the floor; zeros where it has not left it.

    Args:
        joints: World with Z up, metres, the floor at 0.
        first: A pose that is on the floor whatever it looks like; broadcasts against ``batch``.
    """
    height = joints[..., TOES, 2].amin(dim=-1)
    given = first[..., TOES, 2].amin(dim=-1)
    height = height.clamp(given.clamp_max(0.0), given.clamp_min(_ABOVE_FLOOR)) - height
    return torch.nn.functional.pad(height[..., None], (2, 0))


def rows_of(matrices: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 6"]:
    """Return the first two **rows**, one after the other (DART and WANDR; HumanML3D takes columns)."""
    return matrices[..., :2, :].flatten(-2)


def matrices_of(rows: Float[torch.Tensor, "*batch 6"]) -> Float[torch.Tensor, "*batch 3 3"]:
    """Rotation matrices of six numbers that may be no rotation: Gram-Schmidt, the first row keeps its direction."""
    first = rows[..., :3]
    second = rows[..., 3:]
    first = unit(first)
    second = unit(second - (first * second).sum(-1, keepdim=True) * first)
    return torch.stack((first, second, torch.linalg.cross(first, second)), -2)


@lru_cache(maxsize=8)
class _Tree:
    """The skeleton as tensors.

    The joints of a level are equally many bones away from the pelvis; beside them, their parents' places in the level
    above.
    """

    def __init__(self, dtype: torch.dtype, device: torch.device) -> None:
        self.levels: list[tuple[torch.Tensor, torch.Tensor]] = []
        listed = [0]
        above = [0]
        while below := [joint for joint in range(N_JOINTS) if PARENTS[joint] in above]:
            parents = [above.index(PARENTS[joint]) for joint in below]
            self.levels.append((torch.tensor(below, device=device), torch.tensor(parents, device=device)))
            listed = listed + below
            above = below
        # From the joints level by level to the usual order.
        self.order = torch.tensor([listed.index(joint) for joint in range(N_JOINTS)], device=device)
        rest = torch.zeros(N_JOINTS, 3)
        for direction, joints in _REST.items():
            rest[list(joints)] = torch.tensor(direction)
        # Any axis at a right angle to the bone will do, as long as it is always the same one.
        axis = torch.where(rest[:, 2:].abs() > 0, torch.tensor(_Y), torch.tensor(_Z))
        self.rest = rest.to(device, dtype)
        self.half_turns = torch.linalg.cross(axis, rest).to(device, dtype)
