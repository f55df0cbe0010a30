"""Every body on one skeleton, as HumanML3D has it, and back.

Source: docs/specification/humanml3d.md#forward-conversion, step 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint, bone_lengths
from prbench.representation.clips import IN_MEMORY, check_joints
from prbench.representation.features import REST_DIRECTIONS, REST_OFFSETS

_LEG = (Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE)  # ends of the two bones that decide the scale: right thigh and shin


def rest_offsets(joints: Float[np.ndarray, "*batch 22 3"]) -> Float[np.ndarray, "*batch 22 3"]:
    """The rest skeleton with a pose's own bone lengths: offset of each joint from its parent, metres."""
    offsets = np.zeros(joints.shape)
    offsets[..., 1:, :] = REST_DIRECTIONS[1:] * bone_lengths(joints)[..., None]
    return offsets


def root_scale(
    joints: Float[np.ndarray, "*batch 22 3"], offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS
) -> Float[np.ndarray, "*batch"]:
    """Factor s of the root's path: right thigh and shin of the uniform skeleton over those of the pose."""
    own = bone_lengths(joints)[..., np.array(_LEG) - 1].sum(axis=-1)
    return np.asarray(np.linalg.norm(offsets[np.array(_LEG)], axis=-1).sum() / own)


def retarget(
    joints: Float[np.ndarray, "frames ..."],
    *,
    offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS,
    source: Path | str = IN_MEMORY,
    upright: bool = True,
) -> Float[np.ndarray, "frames 22 3"]:
    """The motion on the uniform skeleton: every bone keeps its direction, the root's path is scaled about the origin.

    Feet no longer stand exactly on the floor; :func:`prbench.representation.canonicalise` puts them there again.

    Args:
        joints: (frames, 22, 3), any frame with Y up, metres.
        offsets: Rest offsets of the skeleton to come to.
        source: File or name that messages begin with.
        upright: False for people who lie or crawl.

    Returns:
        Same frame, metres; the type of the numbers stays.

    Raises:
        InputFileError: as :func:`prbench.representation.check_joints`.
    """
    check_joints(np.asarray(joints), source=source, min_frames=1, upright=upright)
    return _with_lengths(joints, root_scale(joints[0], offsets), np.linalg.norm(offsets, axis=-1)).astype(joints.dtype)


@dataclass(frozen=True)
class UniformSkeleton:
    """Change of a batch of bodies to and from the skeleton of a model that learnt from HumanML3D.

    Conditions go in with :meth:`poses` and :meth:`locations`, generated motion comes out with :meth:`own_scale`
    (docs/specification/pr-model.md#data-and-features). Lengths scale about the canonical origin; bone proportions stay
    the model's.
    """

    scale: Float[np.ndarray, " batch"]
    """Root scale s of each body."""
    offsets: Float[np.ndarray, "22 3"]
    """Rest offsets of the uniform skeleton, metres."""

    @classmethod
    def of(
        cls, initial_joints: Float[np.ndarray, "batch 22 3"], offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS
    ) -> UniformSkeleton:
        """The change of skeleton for bodies whose first frames are given.

        Raises:
            InputFileError: if a body has no right leg to measure.
        """
        check_joints(initial_joints, source="initial_joints", min_frames=0, upright=False)
        return cls(root_scale(initial_joints, offsets), offsets)

    def poses(self, joints: Float[np.ndarray, "batch *frames 22 3"]) -> Float[np.ndarray, "batch *frames 22 3"]:
        """Poses of the bodies, on the uniform skeleton."""
        scale = self._like(joints)[..., 0, 0]
        return _with_lengths(joints, scale, np.linalg.norm(self.offsets, axis=-1)).astype(joints.dtype)

    def locations(self, points: Float[np.ndarray, "batch *points 3"]) -> Float[np.ndarray, "batch *points 3"]:
        """Places in the world of the bodies (goals, object locations), in that of the uniform skeleton."""
        return (points * self._like(points)).astype(points.dtype)

    def own_scale(self, joints: Float[np.ndarray, "batch *points 3"]) -> Float[np.ndarray, "batch *points 3"]:
        """Bring what was generated on the uniform skeleton to the scale of the bodies."""
        return (joints / self._like(joints)).astype(joints.dtype)

    def _like(self, values: np.ndarray) -> np.ndarray:
        return self.scale.reshape(-1, *(1,) * (values.ndim - 1))


def _with_lengths(joints: np.ndarray, scale: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Same bone directions, other lengths (22,); the pelvis is scaled (scale broadcasts against poses)."""
    moved = np.empty(joints.shape)
    moved[..., Joint.PELVIS, :] = joints[..., Joint.PELVIS, :] * np.asarray(scale)[..., None]
    for joint in range(1, N_JOINTS):
        bone = np.asarray(joints[..., joint, :] - joints[..., PARENTS[joint], :], dtype=np.float64)
        direction = bone / np.linalg.norm(bone, axis=-1, keepdims=True)
        moved[..., joint, :] = moved[..., PARENTS[joint], :] + direction * lengths[joint]
    return moved
