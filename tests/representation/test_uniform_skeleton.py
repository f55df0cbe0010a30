"""One skeleton for every body, and back to the body's own scale."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, Joint, bone_lengths
from prbench.representation import REST_OFFSETS, UniformSkeleton, rest_offsets, retarget, root_scale
from prbench.representation.features import BONE_LENGTHS
from tests.fakes import STANDING
from tests.representation.motions import walk

SMALL = (STANDING * 0.6).astype(np.float32)


def unit_bones(joints: np.ndarray) -> np.ndarray:
    bones = joints[..., 1:, :] - joints[..., PARENTS[1:], :]
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def test_every_bone_keeps_its_direction_and_takes_the_common_length():
    joints = walk("retarget", 20)
    uniform = retarget(joints)
    assert uniform.dtype == joints.dtype
    assert np.allclose(bone_lengths(uniform), BONE_LENGTHS[1:], atol=1e-6)
    assert np.allclose(unit_bones(uniform), unit_bones(joints), atol=1e-5)


def test_the_path_is_scaled_by_the_right_leg_alone():
    joints = walk("path", 20)
    thigh, shin = joints[0, [5, 8]] - joints[0, [2, 5]]
    scale = (0.390126109 + 0.425707549) / (np.linalg.norm(thigh) + np.linalg.norm(shin))
    assert root_scale(joints[0]) == pytest.approx(scale)
    assert np.allclose(retarget(joints)[:, Joint.PELVIS], joints[:, Joint.PELVIS] * scale, atol=1e-6)


def test_a_body_of_the_uniform_skeleton_stays_as_it_is():
    uniform = retarget(walk("twice", 20))
    assert np.allclose(retarget(uniform), uniform, atol=1e-6)


def test_own_bone_lengths_make_an_own_rest_skeleton():
    offsets = rest_offsets(SMALL)
    assert np.allclose(np.linalg.norm(offsets[1:], axis=-1), bone_lengths(SMALL))
    assert np.allclose(retarget(np.stack([SMALL, SMALL]), offsets=offsets), SMALL, atol=1e-6)


def test_conditions_go_in_and_motion_comes_back_at_the_body_s_scale():
    """A body proportioned as the uniform skeleton, at two sizes: the way there and back is the identity."""
    uniform = retarget(walk("sizes", 20))
    motions = np.stack([uniform * 0.7, uniform * 1.2]).astype(np.float32)
    goals = np.array([[0.5, 0.9, 1.5], [-1.0, 1.1, 0.4]])
    skeleton = UniformSkeleton.of(motions[:, 0])
    assert np.allclose(skeleton.scale, (1 / 0.7, 1 / 1.2))
    assert np.allclose(skeleton.poses(motions), uniform, atol=2e-6)
    assert np.allclose(skeleton.poses(motions[:, 0]), uniform[0], atol=2e-6)
    assert np.allclose(skeleton.locations(goals), goals / [[0.7], [1.2]])
    assert np.allclose(skeleton.own_scale(skeleton.poses(motions)), motions, atol=2e-6)
    assert np.allclose(skeleton.own_scale(skeleton.locations(goals)), goals)


def test_single_poses_of_a_batch_are_those_of_the_motion():
    motion = walk("pose", 10)
    skeleton = UniformSkeleton.of(motion[:1])
    assert np.allclose(skeleton.poses(motion[None])[0], retarget(motion), atol=1e-6)


def test_a_body_without_a_leg_is_refused():
    broken = np.stack([STANDING, STANDING])
    broken[1, Joint.RIGHT_ANKLE] = broken[1, Joint.RIGHT_KNEE]
    with pytest.raises(InputFileError, match="initial_joints, frame 1, right_ankle"):
        UniformSkeleton.of(broken)


def test_rest_offsets_follow_the_rest_directions():
    assert np.allclose(np.linalg.norm(REST_OFFSETS, axis=-1), BONE_LENGTHS)
