"""A synthetic body model with SMPL-H's keys, and procedural people in its terms.

Sixteen shape directions are the sixteen lengths in which people of all presets differ, so that rest joints are exact
(docs/specification/synthetic-recordings.md#native-layouts). Nothing of the licensed model is in it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.readers.egoallo import format as ego
from prbench.synthetic.performance import Performance

_STATURE = 1.70  # of the template person, metres
_UNIT = 0.05  # a shape number of 1 is this share of the template's length

# Bones by the joint they end at, as shares of stature: x left, y up, z forward; a T pose. Left side; the right one is
# its mirror image. Each group is one shape direction.
_GROUPS: tuple[dict[Joint, tuple[float, float, float]], ...] = (
    {
        Joint.LEFT_HIP: (0.036, 0.0, 0.0),
        Joint.LEFT_COLLAR: (0.041, 0.0, 0.0),
        Joint.LEFT_SHOULDER: (0.0695, 0.0, 0.0),
    },
    {
        Joint.LEFT_HIP: (0.0, -0.048, -0.006),
        Joint.LEFT_COLLAR: (0.0, 0.0, -0.010),
        Joint.LEFT_SHOULDER: (0.0, 0.012, -0.008),
    },
    {Joint.LEFT_KNEE: (0.0, -0.2252, 0.0)},
    {Joint.LEFT_ANKLE: (0.0, -0.2466, 0.0)},
    {Joint.LEFT_FOOT: (0.0, -0.036, 0.076)},
    {Joint.SPINE1: (0.0, 0.0756, 0.0)},
    {Joint.SPINE2: (0.0, 0.0823, 0.0)},
    {Joint.SPINE3: (0.0, 0.033, 0.0)},
    {Joint.SPINE1: (0.0, 0.0, -0.010), Joint.SPINE2: (0.0, 0.0, 0.004), Joint.SPINE3: (0.0, 0.0, 0.002)},
    {Joint.NECK: (0.0, 0.126, 0.0)},
    {Joint.NECK: (0.0, 0.0, -0.012)},
    {Joint.LEFT_COLLAR: (0.0, 0.060, 0.0)},
    {Joint.HEAD: (0.0, 0.0465, 0.0)},
    {Joint.HEAD: (0.0, 0.0, 0.0368)},
    {Joint.LEFT_ELBOW: (0.149, 0.0, 0.0)},
    {Joint.LEFT_WRIST: (0.154, 0.0, 0.0)},
)
_NECK_LENGTH = 0.0593
_NECK_TILT = np.deg2rad(38.3)
_HEAD_BONE = _NECK_LENGTH * np.array([0.0, np.cos(_NECK_TILT), np.sin(_NECK_TILT)])
_EXACT = 1e-7  # metres; people are made of these lengths


@cache
def synthetic_smplh() -> ego.SmplhRest:
    """Return the synthetic model: rest joints of a mean person, and what each of the 16 shape numbers adds to them."""
    bones = np.stack([_group_bones(group) for group in _GROUPS], axis=-1) * _STATURE
    joints = np.zeros_like(bones)
    for child in range(1, N_JOINTS):
        joints[child] = joints[PARENTS[child]] + bones[child]
    return ego.SmplhRest(joints.sum(axis=-1), joints * _UNIT)


def shape_of(performance: Performance) -> Float[np.ndarray, "16"]:
    """Return the shape numbers that give the person's own rest joints, but for the head.

    Whoever is seen, a body model puts the head joint where *it* has one: the neck-head bone leans by 38.3 degrees,
    also in people whose own suit says 7.4 (the head tilts of the manifests).

    Raises:
        ValueError: if the model cannot express the person: a preset whose bodies differ in other lengths.
    """
    rest = synthetic_smplh()
    wanted = _rest_bones(performance)
    wanted[Joint.HEAD] = _HEAD_BONE * performance.person.stature
    directions = np.stack([_bones_of(rest.directions[..., k]) for k in range(ego.N_BETAS)], axis=-1)
    missing = (wanted - _bones_of(rest.template)).reshape(-1)
    betas, *_ = np.linalg.lstsq(directions.reshape(-1, ego.N_BETAS), missing, rcond=None)
    left_over = np.abs(directions.reshape(-1, ego.N_BETAS) @ betas - missing).max()
    if left_over > _EXACT:
        raise ValueError(f"{performance.preset}: a bone differs by {left_over:.6f} m from what the model can express")
    return betas


def _bones_of(joints: Float[np.ndarray, "22 3"]) -> Float[np.ndarray, "22 3"]:
    """Return each joint minus its parent; zero for the pelvis."""
    parents = np.maximum(np.array(PARENTS), 0)
    return joints - joints[parents]


def _rest_bones(performance: Performance) -> Float[np.ndarray, "22 3"]:
    """Return the person's bones in the model's rest pose: measured in the parents' frames, where they never change."""
    bones = np.zeros((N_JOINTS, 3))
    rotations = model_rotations(performance.rotations[:1])
    for child in range(1, N_JOINTS):
        parent = PARENTS[child]
        bone = performance.joints[0, child] - performance.joints[0, parent]
        bones[child] = Rotation.from_quat(rotations[0, parent], scalar_first=True).inv().apply(bone)
    return bones


def model_rotations(segments: Float[np.ndarray, "n 22 4"]) -> Float[np.ndarray, "n 22 4"]:
    """Return the world rotations of the model's joints from those of a performance's segments.

    The two differ in the limbs: a segment has y along its bone, the model's rest pose has legs downwards and arms
    sideways.
    """
    turned = segments.copy()
    for joints, segment_from_rest in _LIMB_FRAMES:
        for joint in joints:
            turned[:, joint] = (Rotation.from_quat(segments[:, joint], scalar_first=True) * segment_from_rest).as_quat(
                scalar_first=True
            )
    return turned


_LIMB_FRAMES: tuple[tuple[tuple[Joint, ...], Rotation], ...] = (
    ((Joint.LEFT_HIP, Joint.LEFT_KNEE, Joint.RIGHT_HIP, Joint.RIGHT_KNEE), Rotation.from_euler("x", np.pi)),
    ((Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST), Rotation.from_euler("z", np.pi / 2)),
    ((Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST), Rotation.from_euler("z", -np.pi / 2)),
)


def _group_bones(group: dict[Joint, tuple[float, float, float]]) -> Float[np.ndarray, "22 3"]:
    bones = np.zeros((N_JOINTS, 3))
    for joint, bone in group.items():
        bones[joint] = bone
        if joint.name.startswith("LEFT_"):
            bones[joint + 1] = np.multiply(bone, (-1.0, 1.0, 1.0))
    return bones
