"""Rotations bring the positions back, without flips, and say how far they miss where bones change."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import PARENTS, Joint, forward_kinematics
from prbench.viewing.exporting.skeleton import NESTED_ORDER, own_offsets, pose_skeleton
from tests.fakes import STANDING
from tests.representation.converters.bodies import person, person_rotations


def _rebuilt(posed) -> np.ndarray:
    return forward_kinematics(posed.offsets, posed.root, posed.local, PARENTS)[0]


@pytest.mark.parametrize("joints", [person(60), person_rotations(60)[0]], ids=["synthetic", "rigid"])
def test_rotations_bring_the_positions_back(joints):
    posed = pose_skeleton(joints)
    np.testing.assert_allclose(posed.error, np.linalg.norm(_rebuilt(posed) - joints, axis=2), atol=1e-9)
    assert posed.error.max() < 0.003
    np.testing.assert_allclose(np.linalg.det(posed.local), 1.0, atol=1e-9)


def test_a_bone_that_changes_moves_its_own_joint_alone_and_is_told():
    joints = np.repeat(STANDING[None], 4, axis=0)
    joints[2:, Joint.LEFT_ELBOW] += (0.0, -0.04, 0.0)
    joints[:, Joint.LEFT_WRIST] = joints[:, Joint.LEFT_ELBOW] + [0.0, 0.0, 0.25]  # bent, so that it can make up for it
    error = pose_skeleton(joints).error
    assert error[:, Joint.LEFT_ELBOW].max() == pytest.approx(0.02, abs=1e-3)
    assert error[:, Joint.LEFT_WRIST].max() < 0.003
    assert np.delete(error, [Joint.LEFT_ELBOW, Joint.LEFT_WRIST], axis=1).max() < 1e-9


def test_no_joint_flips_while_an_arm_goes_all_around():
    joints = np.repeat(STANDING[None], 120, axis=0)
    turn = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 120)[:, None] * [1.0, 0.0, 0.0]).as_matrix()
    arm = [Joint.LEFT_ELBOW, Joint.LEFT_WRIST]
    joints[:, arm] = STANDING[16] + (STANDING[arm] - STANDING[16]) @ np.swapaxes(turn, 1, 2)
    local = pose_skeleton(joints).local
    steps = Rotation.from_matrix((np.swapaxes(local[:-1], 2, 3) @ local[1:]).reshape(-1, 3, 3)).magnitude()
    assert np.rad2deg(steps.max()) < 12  # 3 degrees a frame, more where the arm passes behind


def test_the_rest_pose_is_a_t_facing_forward_and_half_turns_and_missing_bones_are_no_nan():
    offsets = own_offsets(person(30))
    assert offsets[Joint.LEFT_ELBOW, 0] > 0 > offsets[Joint.RIGHT_ELBOW, 0]
    assert offsets[Joint.LEFT_FOOT, 2] > 0
    joints = np.repeat(STANDING[None], 2, axis=0)
    joints[:, Joint.LEFT_WRIST] = joints[:, Joint.LEFT_ELBOW]  # no bone
    joints[:, Joint.RIGHT_ELBOW] = joints[:, Joint.RIGHT_SHOULDER] + [0.3, 0.0, 0.0]  # across the chest
    posed = pose_skeleton(joints)
    assert np.isfinite(posed.local).all()
    assert posed.error.max() < 1e-6
    assert all(NESTED_ORDER.index(PARENTS[joint]) < NESTED_ORDER.index(joint) for joint in range(1, 22))
