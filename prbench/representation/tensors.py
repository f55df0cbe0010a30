"""Joints to features and back in torch: batched, padded, differentiable.

Sources: docs/specification/humanml3d.md#forward-conversion and docs/specification/humanml3d.md#inverse.

Nothing here checks its input, because a look at the values would stall the device; check it once with
:func:`prbench.representation.check_joints` before it becomes a tensor. Work is done in the precision that comes in, at
least float32. There is no loop over frames.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch.nn.functional import conv1d, pad

from prbench.geometry.skeleton import PARENTS, Joint
from prbench.representation.features import (
    CONTACT_JOINTS,
    CONTACT_THRESHOLD,
    HALF_TURN_MIDWAYS,
    HEADING_RADIUS,
    JOINT_POSITIONS,
    OPPOSITE,
    REFLECTION_SIGNS,
    REST_DIRECTIONS,
    ROTATION_PARENTS,
    Mode,
    heading_kernel,
)

_TINY = 1e-12  # added under square roots so that a zero vector has a gradient


def decode(features: Float[torch.Tensor, "*batch frames 263"]) -> Float[torch.Tensor, "*batch frames 22 3"]:
    """Joints of every row, from its position features; the motion starts over the origin, facing +Z.

    Frames depend on earlier rows only, so whatever stands in padding never reaches a valid frame.

    Args:
        features: Raw features, not standardised.

    Returns:
        Canonical frame, metres; float32, or float64 if that came in.
    """
    if features.dtype not in (torch.float32, torch.float64):
        features = features.float()
    features = features[..., : JOINT_POSITIONS.stop]
    steps = pad(features[..., :-1, :3].movedim(-1, 0), (1, 0))  # each frame's step from the one before
    turn = 2 * steps[0].cumsum(-1)
    cos = turn.cos()
    sin = turn.sin()
    root_x = (cos * steps[1] - sin * steps[2]).cumsum(-1)
    root_z = (sin * steps[1] + cos * steps[2]).cumsum(-1)
    pelvis = torch.stack((root_x, features[..., 3], root_z), -1)

    x, y, z = features[..., JOINT_POSITIONS].unflatten(-1, (21, 3)).unbind(-1)
    cos, sin, root_x, root_z = (value[..., None] for value in (cos, sin, root_x, root_z))
    joints = torch.stack((cos * x - sin * z + root_x, y, sin * x + cos * z + root_z), -1)
    return torch.cat((pelvis[..., None, :], joints), -2)


def encode(
    joints: Float[torch.Tensor, "batch frames 22 3"],
    n_frames: Int[torch.Tensor, " batch"],
    *,
    next_joints: Float[torch.Tensor, "batch 22 3"] | None = None,
    mode: Mode = "continuous",
) -> Float[torch.Tensor, "batch frames 263"]:
    """Encode canonical joints of any bone lengths to as many rows of features as frames.

    Every row is computed with its own true length, so neither padding nor batch mates change it. The last valid row
    holds the step to ``next_joints`` (docs/specification/pr-model.md#data-and-features).

    Args:
        joints: Canonical frame, metres, 20 fps; frames from ``n_frames[i]`` on are padding and may hold anything.
        n_frames: Valid frames of each sequence, from 1 to ``frames``.
        next_joints: The frame after the last valid one, same frame; None for a copy of that one.
        mode: What happens to the yaw when the heading passes the opposite of its start.

    Returns:
        Raw features; rows of padding are 0. Gradients flow to ``joints`` and ``next_joints``, except through the
        foot contacts, which are steps.
    """
    frame = torch.arange(joints.shape[1] + 1, device=joints.device)
    last = (n_frames - 1)[:, None]
    held = joints[torch.arange(len(joints), device=joints.device)[:, None], torch.minimum(frame, last)]
    if next_joints is not None:
        held = torch.where((frame > last)[..., None, None], next_joints[:, None], held)

    cos, sin, yaw = _headings(held, mode)
    steps = held[:, 1:] - held[:, :-1]
    here = held[:, :-1]
    pelvis = held[:, :-1, Joint.PELVIS]
    ground = pelvis * pelvis.new_tensor((1.0, 0.0, 1.0))
    root_step = _turned(steps[:, :, Joint.PELVIS], cos[:, 1:], sin[:, 1:])
    positions = _turned(here[:, :, 1:] - ground[:, :, None], cos[:, :-1, None], sin[:, :-1, None])
    velocities = _turned(steps, cos[:, :-1, None], sin[:, :-1, None])
    contacts = steps[:, :, CONTACT_JOINTS].square().sum(-1) < CONTACT_THRESHOLD
    features = torch.cat(
        (
            yaw[..., None],
            root_step[..., ::2],
            pelvis[..., 1:2],
            positions.flatten(-2),
            _rotations(here, cos[:, :-1], sin[:, :-1]).flatten(-2),
            velocities.flatten(-2),
            contacts.to(joints.dtype),
        ),
        -1,
    )
    return torch.where((frame[:-1] <= last)[..., None], features, 0.0)


def _headings(joints: torch.Tensor, mode: Mode) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Cosine and sine (B, M) of the turn from the world to each heading, and the half angles (B, M-1) between them.

    Both quirks of the original stand: the hips enter with the opposite sign, and frame 0 is not turned at all.
    """
    across = (
        joints[:, :, Joint.LEFT_HIP]
        - joints[:, :, Joint.RIGHT_HIP]
        + joints[:, :, Joint.RIGHT_SHOULDER]
        - joints[:, :, Joint.LEFT_SHOULDER]
    )
    across = _unit(across)
    forward = torch.stack((across[..., 2], -across[..., 0]), 1)  # x and z of Y x across: (B, 2, M)
    kernel, *_ = _constants(joints.dtype, joints.device)
    edged = pad(forward, (HEADING_RADIUS, HEADING_RADIUS), mode="replicate").flatten(0, 1)[:, None]
    smooth = conv1d(edged, kernel[None, None])[:, 0].unflatten(0, forward.shape[:2])
    x, z = _unit(smooth, dim=1).unbind(1)
    z = torch.where((x == 0) & (z == 0), 1.0, z)  # no heading: not turned

    if mode == "reference":
        # Headings through quaternions (w, y) of positive w, which rounds as the original does opposite to +Z.
        w = (x.square() + z.square()).sqrt() + z
        y = -x
        opposite = (w == 0) & (y == 0)
        w, y = _unit(torch.stack((w, torch.where(opposite, 1.0, y))), dim=0)
        w = pad(w[:, 1:], (1, 0), value=1.0)
        y = pad(y[:, 1:], (1, 0))
        turn = torch.asin((y[:, 1:] * w[:, :-1] - w[:, 1:] * y[:, :-1]).clamp(-1.0, 1.0))
        return w.square() - y.square(), 2 * w * y, turn
    half = pad(0.5 * torch.atan2(-x, z)[:, 1:], (1, 0))
    turn = half.diff(dim=1)
    turn = turn - torch.pi * (turn / torch.pi).round().detach()
    return pad(z[:, 1:], (1, 0), value=1.0), pad(-x[:, 1:], (1, 0)), turn


def _rotations(joints: torch.Tensor, cos: torch.Tensor, sin: torch.Tensor) -> torch.Tensor:
    """Six numbers (B, N, 21, 6) for each joint but the pelvis: the rotation of its bone seen from the bone before.

    The shortest rotation from the rest direction u to the bone direction v is the reflection at u followed by the one
    at the direction half-way between them: ``(2 w w' - 1)(2 u u' - 1)``.
    """
    _, rest, half_turn, signs = _constants(joints.dtype, joints.device)
    bones = _unit(joints[:, :, 1:] - joints[:, :, PARENTS[1:]])
    midway = bones + rest
    opposite = midway.square().sum(-1, keepdim=True) < OPPOSITE**2
    midway = _unit(torch.where(opposite, half_turn, midway))
    turned = 2 * midway[..., :, None] * midway[..., None, :] - torch.eye(3, dtype=joints.dtype, device=joints.device)
    bone_rotations = turned * signs[:, None, :]

    zero = torch.zeros_like(cos)
    one = torch.ones_like(cos)
    heading = torch.stack((cos, zero, sin, zero, one, zero, -sin, zero, cos), -1).unflatten(-1, (1, 3, 3))
    before = torch.cat((heading, bone_rotations), 2)[:, :, ROTATION_PARENTS[1:]]
    relative = before.mT @ bone_rotations[..., :2]
    return relative.mT.flatten(-2)


def _turned(vectors: torch.Tensor, cos: torch.Tensor, sin: torch.Tensor) -> torch.Tensor:
    """Vectors (..., 3) turned about +Y; angles broadcast against their leading axes."""
    x, y, z = vectors.unbind(-1)
    return torch.stack((cos * x + sin * z, y, cos * z - sin * x), -1)


def _unit(vectors: torch.Tensor, dim: int = -1) -> torch.Tensor:
    """Unit vectors; a zero vector stays zero and has no gradient of NaN."""
    square = vectors.square().sum(dim, keepdim=True)
    return vectors * torch.where(square > _TINY**2, square, 1.0).rsqrt()


@lru_cache(maxsize=8)
def _constants(dtype: torch.dtype, device: torch.device) -> tuple[torch.Tensor, ...]:
    """The kernel of headings; and of the skeleton: rest directions, half-turn midways and reflection signs."""
    arrays = (heading_kernel(), REST_DIRECTIONS[1:], HALF_TURN_MIDWAYS[1:], REFLECTION_SIGNS[1:])
    return tuple(torch.as_tensor(value, dtype=dtype, device=device) for value in arrays)
