"""Posing of MANO's hand, on an invented model, against a slow independent implementation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.readers.hot3d import hands as mano
from prbench.readers.hot3d.hands import ManoModel

RNG = np.random.default_rng(5)
N = 30


def invented_model(n: int = N, seed: int = 5) -> ManoModel:
    rng = np.random.default_rng(seed)
    weights = rng.random((n, mano.N_MANO_JOINTS)) ** 8
    regressor = rng.random((mano.N_MANO_JOINTS, n)) ** 8
    return ManoModel(
        template=rng.normal(0.0, 0.05, (n, 3)),
        shape_directions=rng.normal(0.0, 0.002, (n, 3, mano.N_BETAS)),
        pose_directions=rng.normal(0.0, 0.002, (n, 3, 135)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        regressor=regressor / regressor.sum(axis=1, keepdims=True),
        parents=np.array([-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]),
        components=rng.normal(0.0, 0.3, (mano.N_COEFFICIENTS, 45)),
        mean_pose=rng.normal(0.0, 0.2, 45),
    )


def _posed_slowly(model: ManoModel, betas, coefficients, rotation, translation) -> tuple[np.ndarray, np.ndarray]:
    shaped = model.template + (model.shape_directions * betas).sum(axis=2)
    joints = model.regressor @ shaped
    pose = (model.mean_pose + sum(c * row for c, row in zip(coefficients, model.components, strict=True))).reshape(
        15, 3
    )
    local = [Rotation.from_quat(rotation, scalar_first=True).as_matrix()]
    local += [Rotation.from_rotvec(vector).as_matrix() for vector in pose]
    bend = np.concatenate([(matrix - np.eye(3)).ravel() for matrix in local[1:]])
    posed = shaped + model.pose_directions @ bend
    world = []
    for joint, parent in enumerate(model.parents):
        step = np.eye(4)
        step[:3, :3] = local[joint]
        step[:3, 3] = joints[joint] - (joints[parent] if joint else 0.0)
        world.append(step if joint == 0 else world[parent] @ step)
    vertices = []
    for vertex, weights in zip(posed, model.weights, strict=True):
        moved = [g @ np.append(vertex - j, 1.0) for g, j in zip(world, joints, strict=True)]
        vertices.append((weights @ np.array(moved))[:3] + translation)
    return world[0][:3, 3] + translation, np.array(vertices)


def test_vertices_and_wrist_equal_the_slow_computation() -> None:
    model = invented_model()
    betas, coefficients = RNG.normal(size=10), RNG.normal(size=(4, 15))
    rotation, translation = Rotation.random(4, rng=RNG).as_quat(scalar_first=True), RNG.normal(size=(4, 3))
    wrist, vertices = mano.pose_hand(model, betas, coefficients, rotation, translation)
    for frame in range(4):
        slow = _posed_slowly(model, betas, coefficients[frame], rotation[frame], translation[frame])
        assert wrist[frame] == pytest.approx(slow[0], abs=1e-12)
        assert vertices[frame] == pytest.approx(slow[1], abs=1e-12)


def test_the_wrist_is_the_root_joint_and_not_the_translation() -> None:
    model = invented_model()
    root = model.regressor[0] @ model.template
    upright, nothing = np.array([[1.0, 0, 0, 0]]), np.zeros((1, 15))
    wrist, _ = mano.pose_hand(model, np.zeros(10), nothing, upright, np.array([[1.0, 2.0, 3.0]]))
    assert wrist[0] == pytest.approx(root + np.array([1.0, 2.0, 3.0]))
    turned = Rotation.from_rotvec([0.0, 1.0, 0.0]).as_quat(scalar_first=True)[None]
    again, _ = mano.pose_hand(model, np.zeros(10), nothing, turned, np.array([[1.0, 2.0, 3.0]]))
    assert again == pytest.approx(wrist), "the hand turns about its wrist"


def test_a_left_hand_with_the_right_hand_s_shape_directions_is_mended() -> None:
    right = invented_model()
    mended = mano.without_left_hand_bug(right, right)
    assert mended.shape_directions[:, 0] == pytest.approx(-right.shape_directions[:, 0])
    assert mended.shape_directions[:, 1:] == pytest.approx(right.shape_directions[:, 1:])
    other = replace(right, shape_directions=right.shape_directions + 0.1)
    assert mano.without_left_hand_bug(other, right) is other, "a mended file is left alone"
