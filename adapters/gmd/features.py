"""The features of GMD: HumanML3D's with an absolute root, and the random projection that emphasises it.

docs/specification/gmd.md#representation. Column 0 holds half the heading (radians), columns 1 and 2 the pelvis' x and z
(metres, canonical frame), all at the frame itself; the other 260 columns are those of docs/specification/humanml3d.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from prbench.geometry.skeleton import Joint
from prbench.randomness import named_generator
from prbench.representation.features import JOINT_POSITIONS, N_FEATURES, ROOT_HEIGHT

HEADING = slice(0, 1)
"""Half the turn of the heading since the first frame, radians."""
ROOT_XZ = slice(1, 3)
"""Pelvis on the ground, canonical frame, metres."""
N_ROOT = ROOT_HEIGHT.stop
"""Columns of the root, which are all that the trajectory network sees."""
N_POSE = JOINT_POSITIONS.stop
"""Columns that decide the joints of a frame: root and joint positions."""
_EMPHASISED = 3
_DRAW = 13
"""Number of the draw of A: of the first forty the one that is best to invert, condition number 1108."""


def with_absolute_root(
    features: Float[Tensor, "*batch frames 263"],
) -> Float[Tensor, "*batch frames 263"]:
    """Replace the steps of the root, columns 0 to 2, by where they lead from the origin."""
    steps = pad(features[..., :-1, : ROOT_XZ.stop].movedim(-1, 0), (1, 0))  # each frame's step from the one before
    # The column holds half of each frame's turn, and sums of halves are half of the sum.
    half_turn = steps[0].cumsum(-1)
    cos = (2 * half_turn).cos()
    sin = (2 * half_turn).sin()
    x = (cos * steps[1] - sin * steps[2]).cumsum(-1)
    z = (sin * steps[1] + cos * steps[2]).cumsum(-1)
    return torch.cat((torch.stack((half_turn, x, z), -1), features[..., ROOT_HEIGHT.start :]), -1)


def decode_absolute(features: Float[Tensor, "*batch frames columns"]) -> Float[Tensor, "*batch frames 22 3"]:
    """Joints of every row, from its first 67 columns alone; canonical frame, metres."""
    half_turn, root_x, root_z = features[..., : ROOT_XZ.stop].unbind(-1)
    pelvis = torch.stack((root_x, features[..., ROOT_HEIGHT.start], root_z), -1)
    cos = (2 * half_turn).cos()[..., None]
    sin = (2 * half_turn).sin()[..., None]
    x, y, z = features[..., JOINT_POSITIONS].unflatten(-1, (21, 3)).unbind(-1)
    joints = torch.stack((cos * x - sin * z + root_x[..., None], y, sin * x + cos * z + root_z[..., None]), -1)
    return torch.cat((pelvis[..., None, :], joints), -2)


def pose_columns(joints: Float[Tensor, "batch 22 3"], half_turn: Float[Tensor, " batch"]) -> Float[Tensor, "batch 67"]:
    """The columns that decode to a pose, given its heading: any heading leads back to the same joints.

    Args:
        joints: Canonical frame, metres.
        half_turn: Half the turn of the heading, radians; 0 for the first frame of a motion.
    """
    pelvis = joints[:, Joint.PELVIS]
    # Heights stay: only x and z are relative to the pelvis.
    local = joints[:, 1:] - pelvis[:, None] * pelvis.new_tensor((1.0, 0.0, 1.0))
    cos = (2 * half_turn).cos()[:, None]
    sin = (2 * half_turn).sin()[:, None]
    x, y, z = local.unbind(-1)
    turned = torch.stack((cos * x + sin * z, y, cos * z - sin * x), -1)
    return torch.cat((half_turn[:, None], pelvis[:, ::2], pelvis[:, 1:2], turned.flatten(1)), dim=1)


def half_turn_of(joints: Float[Tensor, "batch 22 3"]) -> Float[Tensor, " batch"]:
    """Half the turn of a single pose's heading, by hips and shoulders as the representation takes them, unsmoothed."""
    across = (
        joints[:, Joint.LEFT_HIP]
        - joints[:, Joint.RIGHT_HIP]
        + joints[:, Joint.RIGHT_SHOULDER]
        - joints[:, Joint.LEFT_SHOULDER]
    )
    return 0.5 * torch.atan2(-across[:, 2], -across[:, 0])


@dataclass(frozen=True)
class FeatureSpace:
    """Leads from raw features to what the networks see and back: statistics, projection and its inverse."""

    mean: Float[Tensor, " 263"]
    std: Float[Tensor, " 263"]
    projection: Float[Tensor, "263 263"]
    """A: the motion network sees standardised features times A."""
    inverse: Float[Tensor, "263 263"]

    @classmethod
    def of(
        cls, mean: Float[Tensor, " 263"], std: Float[Tensor, " 263"], projection: Float[Tensor, "263 263"]
    ) -> FeatureSpace:
        """Compute the inverse in float64, because A is badly conditioned."""
        inverse = torch.linalg.inv(projection.double().cpu()).to(projection)
        return cls(mean.to(projection), std.to(projection), projection, inverse)

    def to(self, device: torch.device | str) -> FeatureSpace:
        """Move the space to a device."""
        return FeatureSpace(*(part.to(device) for part in (self.mean, self.std, self.projection, self.inverse)))

    def standardised(self, raw: Float[Tensor, "*batch columns"]) -> Float[Tensor, "*batch columns"]:
        """Standardise the first columns, as many as there are."""
        columns = raw.shape[-1]
        return (raw - self.mean[:columns]) / self.std[:columns]

    def restored(self, standardised: Float[Tensor, "*batch columns"]) -> Float[Tensor, "*batch columns"]:
        """The inverse of :meth:`standardised`."""
        columns = standardised.shape[-1]
        return standardised * self.std[:columns] + self.mean[:columns]

    def projected(self, standardised: Float[Tensor, "*batch 263"]) -> Float[Tensor, "*batch 263"]:
        """Project features, as the motion network sees them."""
        return standardised @ self.projection

    def unprojected(self, projected: Float[Tensor, "*batch 263"]) -> Float[Tensor, "*batch 263"]:
        """The inverse of :meth:`projected`."""
        return projected @ self.inverse


def emphasis_projection(emphasis: float) -> Float[Tensor, "263 263"]:
    """The fixed random matrix A: standard normal entries, rows 0 to 2 times c, all over √(263 - 3 + 3 c²).

    The numbers are rounded to half precision, in which weights may be stored.
    """
    # Fixed for ever: weights hold what was learnt in this very projection.
    drawn = named_generator("gmd-emphasis-projection", _DRAW).standard_normal((N_FEATURES, N_FEATURES))
    drawn[:_EMPHASISED] *= emphasis
    drawn /= (N_FEATURES - _EMPHASISED + _EMPHASISED * emphasis**2) ** 0.5
    return torch.from_numpy(drawn).half().float()
