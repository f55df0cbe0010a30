"""Features to joints in torch: batched, padded, differentiable (docs/specification/humanml3d.md#inverse).

Nothing here checks its input, because a look at the values would stall the device. Work is done in the precision that
comes in, at least float32. There is no loop over frames.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch.nn.functional import pad

from prbench.representation.features import JOINT_POSITIONS


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
