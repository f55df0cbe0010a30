"""The sample output against the values that EgoAllo's own kinematics gave."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import PARENTS, Joint, bone_lengths
from prbench.readers.egoallo.bodies import read_output, read_smplh_rest
from prbench.readers.egoallo.format import EgoAlloBody
from prbench.readers.egoallo.synthetic import synthetic_smplh
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.representation.converters.smpl import pose_body

NAME = "egoallo/egoallo_outputs/20240101-120000_0-12.npz"
MODEL = "egoallo/mock_smplh/neutral/model.npz"


def _body(samples) -> EgoAlloBody:
    body = body_from_outputs([read_output(samples / NAME)], read_smplh_rest(samples / MODEL))
    assert body is not None
    return body


def test_shape(samples, reference_values):
    expected = reference_values["egoallo-shape"]["expect"]
    body = _body(samples)
    assert len(read_output(samples / NAME).world_from_root) == expected["samples"]
    assert body.joints.shape == (expected["frames"], expected["joints"], 3)
    assert [int(body.time_ns[0]), int(body.time_ns[-1])] == [expected["first_ns"], expected["last_ns"]]


def test_joints_of_the_first_frame_with_its_own_shape(samples, reference_values):
    item = reference_values["egoallo-joints-0"]
    output, rest = read_output(samples / NAME), read_smplh_rest(samples / MODEL)
    root = output.world_from_root[0, :1].astype(np.float64)
    rotations = np.concatenate([root[:, None, :4], output.body_quats[0, :1]], axis=1)
    joints, _ = pose_body(rest.of(output.betas[0, 0]), root[:, 4:], rotations)
    np.testing.assert_allclose(joints[0], item["expect"]["joints"], atol=1e-6)


def test_joints_with_the_mean_shape_keep_their_bones_and_stay_near(samples, reference_values):
    window = _body(samples)
    expected = np.array(reference_values["egoallo-joints-0"]["expect"]["joints"])
    assert np.linalg.norm(window.joints[0] - expected, axis=1).max() < 0.05  # only the shape differs
    bones = np.linalg.norm(np.diff(window.joints[:, [1, 4, 7, 10]], axis=1), axis=2)
    assert np.ptp(bones, axis=0).max() < 1e-5


IDENTITY = np.array([1.0, 0, 0, 0])


def _pose(seed: int, n: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    quats = Rotation.random(n * 22, rng).as_quat(scalar_first=True).reshape(n, 22, 4)
    return rng.normal(size=(22, 3)), rng.normal(size=(n, 3)), quats


def _slow(rest, position, rotations):
    """One frame, one joint, 4x4 matrices."""
    frames = []
    for frame in range(len(position)):
        world = []
        for joint in range(22):
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_quat(rotations[frame, joint], scalar_first=True).as_matrix()
            matrix[:3, 3] = position[frame] if joint == 0 else rest[joint] - rest[PARENTS[joint]]
            world.append(matrix if joint == 0 else world[PARENTS[joint]] @ matrix)
        frames.append([matrix[:3, 3] for matrix in world])
    return np.array(frames)


def test_the_pelvis_is_where_the_root_is_and_the_rest_pose_is_carried_along():
    rest = synthetic_smplh().template
    joints, _ = pose_body(rest, np.array([[1.0, 2.0, 3.0]]), np.tile(IDENTITY, (1, 22, 1)))
    np.testing.assert_allclose(joints[0] - joints[0, 0], rest - rest[0], atol=1e-12)
    np.testing.assert_array_equal(joints[0, Joint.PELVIS], [1.0, 2.0, 3.0])


def test_bending_one_knee_moves_the_ankle_and_the_foot_behind_it_and_nothing_else():
    rest = synthetic_smplh().template
    local = np.tile(IDENTITY, (1, 22, 1))
    local[0, Joint.LEFT_KNEE] = Rotation.from_euler("x", np.pi / 2).as_quat(scalar_first=True)
    joints = pose_body(rest, np.zeros((1, 3)), local)[0][0] + rest[0]
    moved = np.linalg.norm(joints - rest, axis=1) > 1e-9
    assert set(np.flatnonzero(moved)) == {Joint.LEFT_ANKLE, Joint.LEFT_FOOT}
    shin = np.linalg.norm(rest[Joint.LEFT_ANKLE] - rest[Joint.LEFT_KNEE])
    np.testing.assert_allclose(joints[Joint.LEFT_ANKLE], rest[Joint.LEFT_KNEE] + (0, 0, -shin), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_it_agrees_with_chained_matrices(seed):
    pose = _pose(seed)
    np.testing.assert_allclose(pose_body(*pose)[0], _slow(*pose), atol=1e-12)


def test_turning_the_root_turns_the_body_about_the_pelvis():
    rest, position, rotations = _pose(7)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.2])
    turned = rotations.copy()
    turned[:, 0] = (turn * Rotation.from_quat(rotations[:, 0], scalar_first=True)).as_quat(scalar_first=True)
    straight = pose_body(rest, position, rotations)[0] - position[:, None]
    other = pose_body(rest, position, turned)[0] - position[:, None]
    np.testing.assert_allclose(other, turn.apply(straight.reshape(-1, 3)).reshape(other.shape), atol=1e-12)
    np.testing.assert_allclose(bone_lengths(other), bone_lengths(straight), atol=1e-12)
