"""Frames of motion as DART describes them: 276 numbers each, and the frame of reference of a primitive.

World with Z up, metres, per frame. Rotations are those that :mod:`prbench_adapters.kinematics` fits to joints,
so no body model is needed; the body's translation is its pelvis
(docs/specification/dart.md#skeleton-only-re-implementation).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor

from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench_adapters.kinematics import fitted_rotations, matrices_of, rows_of, unit

N_FEATURES = 276
_SIZES = (3, 6, 6 * (N_JOINTS - 1), 3, 6, 3 * N_JOINTS, 3 * N_JOINTS)
"""Numbers of each field of :class:`Frames`, in their order."""


@dataclass(frozen=True)
class Placement:
    """Placement of a primitive's frame of reference in another: points there are ``rotation @ p + origin``."""

    rotation: Float[Tensor, "batch 3 3"]
    origin: Float[Tensor, "batch 3"]

    def points(self, points: Float[Tensor, "batch frames *joints 3"]) -> Float[Tensor, "batch frames *joints 3"]:
        """Points given here, there."""
        return _turned(self.rotation, points) + _broadcast(self.origin, points)

    def first(self, n: int) -> Placement:
        """Placements of the first motions."""
        return Placement(self.rotation[:n], self.origin[:n])

    def then(self, inner: Placement) -> Placement:
        """The placement of a frame of reference that is placed here by ``inner``."""
        return Placement(
            self.rotation @ inner.rotation, self.origin + (self.rotation @ inner.origin[..., None])[..., 0]
        )


@dataclass(frozen=True)
class Frames:
    """Frames of B motions in one frame of reference each; deltas lead to the next frame."""

    translation: Float[Tensor, "batch frames 3"]
    orientation: Float[Tensor, "batch frames 3 3"]
    """Orientation of the root."""
    body: Float[Tensor, "batch frames 21 6"]
    """Each other joint's rotation relative to the bone before: the first two rows, as they are; predicted ones need
    not be those of a rotation, and go on to the next history as predicted (as in the original)."""
    translation_delta: Float[Tensor, "batch frames 3"]
    orientation_delta: Float[Tensor, "batch frames 3 3"]
    """Next orientation · this one, transposed."""
    joints: Float[Tensor, "batch frames 22 3"]
    joints_delta: Float[Tensor, "batch frames 22 3"]

    @classmethod
    def of_joints(cls, joints: Float[Tensor, "batch frames_and_one 22 3"]) -> Frames:
        """All frames but the last, which is where the last delta leads to."""
        rotations = fitted_rotations(joints)
        orientation = rotations[:, :, 0]
        pelvis = joints[:, :, Joint.PELVIS]
        return cls(
            translation=pelvis[:, :-1],
            orientation=orientation[:, :-1],
            body=rows_of(rotations[:, :-1, 1:]),
            translation_delta=pelvis.diff(dim=1),
            orientation_delta=orientation[:, 1:] @ orientation[:, :-1].mT,
            joints=joints[:, :-1],
            joints_delta=joints.diff(dim=1),
        )

    @classmethod
    def unpack(cls, features: Float[Tensor, "batch frames 276"]) -> Frames:
        """Read features in metres; orientations that are no rotation become one (Gram-Schmidt)."""
        # In the order of the fields, which is that of the original's 276 numbers.
        translation, orientation, body, step, turn, joints, moves = features.split(_SIZES, dim=-1)
        return cls(
            translation=translation,
            orientation=matrices_of(orientation),
            body=body.unflatten(-1, (N_JOINTS - 1, 6)),
            translation_delta=step,
            orientation_delta=matrices_of(turn),
            joints=joints.unflatten(-1, (N_JOINTS, 3)),
            joints_delta=moves.unflatten(-1, (N_JOINTS, 3)),
        )

    def pack(self) -> Float[Tensor, "batch frames 276"]:
        """Write features, metres: translation 3, rotations 132, delta 3, orientation's delta 6, joints 66, deltas 66.

        Rotations are the first two *rows* of their matrices.
        """
        parts = (
            self.translation,
            rows_of(self.orientation),
            self.body.flatten(2),
            self.translation_delta,
            rows_of(self.orientation_delta),
            self.joints.flatten(2),
            self.joints_delta.flatten(2),
        )
        return torch.cat(parts, dim=-1)

    def rotations(self) -> Float[Tensor, "batch frames 22 3 3"]:
        """The root's orientation and the joints' rotations, for forward kinematics."""
        return torch.cat((self.orientation[:, :, None], matrices_of(self.body)), dim=2)

    def part(self, start: int, stop: int) -> Frames:
        """Some of the frames."""
        return Frames(*(getattr(self, field.name)[:, start:stop] for field in fields(self)))

    def seen_from(self, placement: Placement) -> Frames:
        """Express the frames in the frame of reference that ``placement`` places in the present one."""
        back = placement.rotation.mT
        origin = placement.origin
        return Frames(
            translation=_turned(back, self.translation - _broadcast(origin, self.translation)),
            orientation=back[:, None] @ self.orientation,
            body=self.body,
            translation_delta=_turned(back, self.translation_delta),
            # A turn between two world orientations is changed on both sides; an orientation on the left alone.
            orientation_delta=back[:, None] @ self.orientation_delta @ placement.rotation[:, None],
            joints=_turned(back, self.joints - _broadcast(origin, self.joints)),
            joints_delta=_turned(back, self.joints_delta),
        )

    def canonical(self) -> tuple[Frames, Placement]:
        """The frames in the frame of reference of the first one, and where that stands."""
        placement = canonical_placement(self.joints[:, 0])
        return self.seen_from(placement), placement


def canonical_placement(joints: Float[Tensor, "batch 22 3"]) -> Placement:
    """A pose's own frame: origin in its pelvis, x to the right along the ground, z up, y to the front."""
    across = joints[:, Joint.RIGHT_HIP] - joints[:, Joint.LEFT_HIP]
    up = torch.zeros_like(across)
    up[:, 2] = 1.0
    # Along the ground, so that the frame of reference stays upright however the body leans.
    right = unit(across * (1.0 - up))
    front = torch.linalg.cross(up, right)
    return Placement(torch.stack((right, front, up), dim=-1), joints[:, Joint.PELVIS])


def _turned(
    rotation: Float[Tensor, "batch 3 3"], vectors: Float[Tensor, "batch frames *joints 3"]
) -> Float[Tensor, "batch frames *joints 3"]:
    return (vectors.flatten(1, -2) @ rotation.mT).reshape(vectors.shape)


def _broadcast(origin: Float[Tensor, "batch 3"], points: Tensor) -> Tensor:
    return origin.reshape(len(origin), *(1,) * (points.ndim - 2), 3)
