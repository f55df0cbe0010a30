"""Windows turned about the vertical and mirrored, so that a network learns neither compass nor handedness.

Source: docs/specification/prediction-networks.md#decisions, row 7.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

_SIDES = (("left", "right"), ("right", "left"), ("l", "r"), ("r", "l"))


def mirror_partners(names: Sequence[str]) -> tuple[int, ...]:
    """Index of the joint that each one becomes in a mirror: itself, unless it has a partner on the other side.

    Args:
        names: Joint names that begin with their side: ``left_hip``, ``right_hip``, or ``lHip``, ``rHip``.

    Raises:
        ValueError: if a name tells its side, and its partner is missing.
    """
    place = {name: index for index, name in enumerate(names)}
    partners = []
    for index, name in enumerate(names):
        others = [there + name.removeprefix(here) for here, there in _SIDES if name.startswith(here)]
        found = [place[other] for other in others if other in place]
        if not found and name.startswith(("left", "right")):
            raise ValueError(f"joint '{name}' has no partner on the other side among {', '.join(names)}")
        partners.append(found[0] if found else index)
    return tuple(partners)


def augmented(
    motion: Float[Tensor, "windows frames nodes 3"],
    partners: Sequence[int],
    *,
    turn: Float[Tensor, " windows"],
    mirrored: Bool[Tensor, " windows"],
) -> Float[Tensor, "windows frames nodes 3"]:
    """Windows as they would have been seen turned, or in a mirror.

    Args:
        motion: Metres, Y up; nodes behind the joints are directions, which turn with the body.
        partners: :func:`mirror_partners` of the joints.
        turn: Angle about +Y through the origin, radians; 0 in the frame of the last pose, which has one heading.
        mirrored: Which windows are mirrored at the plane x = 0 before they are turned; left and right joints are
            exchanged, so that the body in the mirror has its labels right.
    """
    order = [*partners, *range(len(partners), motion.shape[2])]
    flipped = motion[:, :, order] * motion.new_tensor([-1.0, 1.0, 1.0])
    motion = torch.where(mirrored[:, None, None, None], flipped, motion)
    cosine, sine = turn.cos()[:, None, None], turn.sin()[:, None, None]
    x, y, z = motion.unbind(-1)
    return torch.stack([cosine * x + sine * z, y, cosine * z - sine * x], dim=-1)
