"""Joint rotations of a skeleton with constant bones, solved so that the positions of the 22 joints come back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint, bone_lengths
from prbench.representation.features import REST_DIRECTIONS

# Joints from which each joint's bones begin.
CHILDREN = tuple(tuple(child for child in range(N_JOINTS) if PARENTS[child] == joint) for joint in range(N_JOINTS))
# Order in which a file with nested joints names them: each before its children, these before its siblings.
NESTED_ORDER = (0, 1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9, 12, 15, 13, 16, 18, 20, 14, 17, 19, 21)
# Bones of the rest pose: a T, from which no joint of a person turns by half a turn, where a shortest turn would flip.
_T_POSE = REST_DIRECTIONS.copy()
_T_POSE[[Joint.LEFT_HIP, Joint.RIGHT_HIP]] = (0.6, -0.8, 0.0), (-0.6, -0.8, 0.0)
_T_POSE[[Joint.LEFT_COLLAR, Joint.RIGHT_COLLAR]] = (0.6, 0.8, 0.0), (-0.6, 0.8, 0.0)
_T_POSE[[Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST]] = (1.0, 0.0, 0.0)
_T_POSE[[Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST]] = (-1.0, 0.0, 0.0)
_T_POSE[Joint.HEAD] = (0.0, 1.0, 0.0)
_HALF_TURN = 1e-6  # length of the sum of two unit vectors below which they are opposite
_Rotations = Float[np.ndarray, "n 3 3"]


@dataclass(frozen=True, eq=False)
class PosedSkeleton:
    """A motion as rotations of a skeleton.

    Attributes:
        offsets: Place of each joint in its parent's frame, metres; rest pose: Y up, facing +Z, arms to the sides.
        root: Position of the pelvis, canonical frame, metres.
        local: Rotation of each joint in its parent, of the pelvis in the canonical frame.
        error: Distance of each joint from where the motion has it, metres; not zero where bones change their length.
    """

    offsets: Float[np.ndarray, "22 3"]
    root: Float[np.ndarray, "n 3"]
    local: Float[np.ndarray, "n 22 3 3"]
    error: Float[np.ndarray, "n 22"]


def pose_skeleton(
    joints: Float[np.ndarray, "n 22 3"], offsets: Float[np.ndarray, "22 3"] | None = None
) -> PosedSkeleton:
    """Solve the rotations of a skeleton, joint after joint from the pelvis outwards.

    A joint with several children turns as fits all of them best (Kabsch, 1976). One with a single child turns from its
    parent's frame by the smallest angle that points at where the motion has the child, as seen from where the skeleton
    has the joint: so errors of changing bones do not add up along a limb, and no twist is invented. Tips do not turn.

    Args:
        joints: Canonical frame, metres.
        offsets: The skeleton in its rest pose; None for the motion's own mean bones in a T-pose.
    """
    offsets = own_offsets(joints) if offsets is None else offsets
    positions = joints.astype(np.float64)
    world = np.tile(np.eye(3), (*joints.shape[:2], 1, 1))
    local = world.copy()
    for joint in range(N_JOINTS):
        before = world[:, PARENTS[joint]].copy()  # of the pelvis the last joint, which has not turned yet
        if joint:
            positions[:, joint] = positions[:, PARENTS[joint]] + before @ offsets[joint]
        children = list(CHILDREN[joint])
        seen = joints[:, children] - positions[:, [joint]]
        world[:, joint] = before
        if len(children) > 1:
            world[:, joint] = _best_rotations(offsets[children], seen)
        elif children:
            world[:, joint] = _shortest_turns(before @ offsets[children[0]], seen[:, 0]) @ before
        local[:, joint] = np.swapaxes(before, 1, 2) @ world[:, joint]
    return PosedSkeleton(offsets, positions[:, 0], local, np.linalg.norm(positions - joints, axis=2))


def own_offsets(joints: Float[np.ndarray, "n 22 3"]) -> Float[np.ndarray, "22 3"]:
    """Return the rest pose of a motion's own skeleton: its mean bone lengths, metres, in a T-pose.

    Hips and collars stand beside the spine as they do on average, because they turn with it as one.
    """
    lengths = np.concatenate([[0.0], bone_lengths(joints.astype(np.float64)).mean(axis=0)])
    offsets = _T_POSE * lengths[:, None]
    for joint in (Joint.PELVIS, Joint.SPINE3):
        children = list(CHILDREN[joint])
        seen = joints[:, children] - joints[:, [joint]]
        for _ in range(3):  # the mean shape decides how each frame is turned, and the turned frames decide the mean
            shape = (seen @ _best_rotations(offsets[children], seen)).mean(axis=0)
            offsets[children] = shape * (lengths[children] / np.linalg.norm(shape, axis=1).clip(1e-9))[:, None]
    return offsets


def _best_rotations(shape: Float[np.ndarray, "k 3"], seen: Float[np.ndarray, "n k 3"]) -> _Rotations:
    """Return the rotations that turn a shape onto what is seen of it with the least squares."""
    left, _, right = np.linalg.svd(np.swapaxes(seen, 1, 2) @ shape)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]  # no mirror image
    return left @ right


def _shortest_turns(one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]) -> _Rotations:
    """Return the rotations by the smallest angle from one direction to another; none where there is no direction."""
    one = _unit(one)
    middle = one + _unit(other)
    # Any axis across the direction serves for a half turn; the one that is farthest from it loses no digits.
    across = np.cross(one, np.eye(3)[np.abs(one).argmin(axis=1)])
    middle = _unit(np.where(np.linalg.norm(middle, axis=1, keepdims=True) < _HALF_TURN, across, middle))
    return _half_turns(middle) @ _half_turns(one)


def _half_turns(axes: Float[np.ndarray, "n 3"]) -> _Rotations:
    return 2 * axes[:, :, None] * axes[:, None] - np.eye(3)


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)
