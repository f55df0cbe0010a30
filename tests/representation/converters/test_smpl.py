"""SMPL, SMPL-H and SMPL-X parameters to joints, with NumPy alone, against SciPy."""

from __future__ import annotations

import pickle
import shlex
import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import rotation_matrices, z_up
from prbench.readers.egoallo.synthetic import synthetic_smplh
from prbench.representation.converters import (
    RestJoints,
    SmplParameters,
    at_rate,
    placed_on,
    quaternions_of,
    read_amass,
    read_rest_joints,
    smpl_joints,
    to_canonical,
)
from prbench.representation.converters.smpl import HOW_TO_CONVERT, from_axis_angle, from_matrices
from tests.representation.converters.bodies import person_rotations, write_body_model

REST = RestJoints.fixed(synthetic_smplh().template)


def written(rotations: np.ndarray, form: str) -> np.ndarray:
    """Matrices (frames, joints, 3, 3) as numbers a frame; independent of what reads them."""
    flat = rotations.reshape(-1, 3, 3)
    numbers = {
        "axis-angle": lambda: Rotation.from_matrix(flat).as_rotvec(),
        "matrix": lambda: flat,
        "quaternion-wxyz": lambda: Rotation.from_matrix(flat).as_quat()[:, [3, 0, 1, 2]],
        "quaternion-xyzw": lambda: Rotation.from_matrix(flat).as_quat(),
        "6d-columns": lambda: np.concatenate([flat[:, :, 0], flat[:, :, 1]], axis=1),
        "6d-rows": lambda: np.concatenate([flat[:, 0], flat[:, 1]], axis=1),
        "6d-interleaved": lambda: flat[:, :, :2],
    }[form]()
    return numbers.reshape(len(rotations), -1)


FORMS = ("axis-angle", "matrix", "quaternion-wxyz", "quaternion-xyzw", "6d-columns", "6d-rows", "6d-interleaved")


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_rotations_gives_the_known_motion(form) -> None:
    joints, rotations = person_rotations(60)
    parameters = SmplParameters.from_poses(written(rotations, form), joints[:, 0] - REST.template[0], form=form)
    assert np.allclose(smpl_joints(parameters, REST), joints, atol=1e-9)


def test_6d_of_another_convention_is_another_motion() -> None:
    joints, rotations = person_rotations(60)
    transl = joints[:, 0] - REST.template[0]
    wrong = SmplParameters.from_poses(written(rotations, "6d-columns"), transl, form="6d-rows")
    assert np.linalg.norm(smpl_joints(wrong, REST) - joints, axis=-1).mean() > 0.05


def test_rotations_need_not_be_exact() -> None:
    rng = np.random.default_rng(0)
    matrices = Rotation.random(20, rng=rng).as_matrix()
    rough = (matrices[:, :, :2] * 1.3 + rng.normal(size=(20, 3, 2)) * 1e-3).reshape(20, 6)
    read = Rotation.from_quat(quaternions_of(rough, "6d-interleaved")[:, 0], scalar_first=True).as_matrix()
    assert np.abs(read - matrices).max() < 1e-2


def test_arguments_of_smplx_and_one_array_are_the_same() -> None:
    _, rotations = person_rotations(10)
    poses = written(rotations, "axis-angle")
    smpl = np.concatenate([poses, np.ones((10, 6))], axis=1)  # 24 joints: hands of SMPL
    transl, betas = np.zeros((10, 3)), np.ones((10, 10))
    one = SmplParameters.from_poses(smpl, transl, betas=betas)
    other = SmplParameters.from_arrays(
        global_orient=smpl[:, :3], body_pose=smpl[:, 3:].reshape(10, 23, 3), transl=transl, betas=betas[0]
    )
    assert np.array_equal(one.rotations, other.rotations)
    assert np.array_equal(one.betas, other.betas)
    assert one.rotations.shape == (10, 22, 4)


def test_the_pelvis_is_not_at_the_translation() -> None:
    pose = SmplParameters.from_poses(np.zeros((1, 66)), np.array([[1.0, 2.0, 3.0]]))
    rest = RestJoints.fixed(REST.template + np.array([0.0, -0.35, 0.01]))
    assert smpl_joints(pose, rest)[0, 0] == pytest.approx(np.array([1.0, 1.65, 3.01]))


@pytest.mark.parametrize(("joints", "shapes"), [(24, 10), (52, 16), (55, 20), (55, 400)])
def test_rest_joints_are_regressed_from_the_shaped_template(tmp_path, joints, shapes) -> None:
    path = tmp_path / "model.npz"
    rest = write_body_model(path, joints=joints, shapes=shapes)
    betas = np.random.default_rng(1).normal(size=10)
    with np.load(path) as file:
        shaped = file["v_template"] + file["shapedirs"][:, :, :10] @ betas
        expected = file["J_regressor"][:22] @ shaped
    read = read_rest_joints(path)
    assert np.allclose(read.of(None), rest)
    assert np.allclose(read.of(betas), expected)


def test_expressions_of_smplx_are_no_shape(tmp_path) -> None:
    path = tmp_path / "SMPLX_NEUTRAL.npz"
    write_body_model(path, joints=55, shapes=20)  # ten of shape, ten of the face
    assert read_rest_joints(path).directions.shape == (22, 3, 10)


def test_shape_numbers_of_zero_beyond_the_model_s_are_harmless(tmp_path) -> None:
    path = tmp_path / "model.npz"
    write_body_model(path, joints=24)
    betas = np.r_[np.ones(10), np.zeros(6)]
    assert np.array_equal(read_rest_joints(path).of(betas), read_rest_joints(path).of(betas[:10]))


def test_the_line_that_converts_a_pickle_does(tmp_path) -> None:
    """As SMPL's licensed file: a sparse regressor, and words among the arrays."""
    model = {
        "J_regressor": csc_matrix(np.eye(24, 60)),
        "v_template": np.ones((60, 3)),
        "shapedirs": np.zeros((60, 3, 10)),
        "bs_type": "lrotmin",
    }
    (tmp_path / "MODEL.pkl").write_bytes(pickle.dumps(model))
    line = shlex.split(HOW_TO_CONVERT[HOW_TO_CONVERT.index("python -c") :])
    subprocess.run([sys.executable, *line[1:]], cwd=tmp_path, check=True)
    assert np.allclose(read_rest_joints(tmp_path / "MODEL.npz").of(None), 1.0)


@pytest.mark.parametrize(("rate_key", "joints"), [("mocap_framerate", 52), ("mocap_frame_rate", 55)])
def test_an_amass_file_becomes_the_canonical_motion_at_20_fps(tmp_path, rate_key, joints) -> None:
    truth, rotations = person_rotations(120)  # at 30 fps, say
    turn = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # Z up from Y up
    world = rotations.copy()
    world[:, 0] = turn @ rotations[:, 0]
    poses = np.zeros((120, joints * 3))
    poses[:, :66] = written(world, "axis-angle")
    np.savez(
        tmp_path / "clip.npz",
        poses=poses,
        trans=z_up(truth[:, 0]) - REST.template[0],
        betas=np.zeros(16),
        gender=np.array("neutral"),
        **{rate_key: np.array(30.0)},
    )
    parameters = read_amass(tmp_path / "clip.npz")
    assert (parameters.fps, parameters.gender) == (30.0, "neutral")
    with_shape = RestJoints(REST.template, np.zeros((22, 3, 16)))
    canonical = to_canonical(smpl_joints(parameters, with_shape), parameters.fps, up="z")
    expected = at_rate(truth, 30.0)
    assert len(canonical) == 80
    assert np.allclose(canonical, placed_on(expected, canonical[0]), atol=1e-5)


RNG = np.random.default_rng(0)


VECTORS = np.concatenate(
    [RNG.normal(size=(200, 3)), 1e-9 * RNG.normal(size=(5, 3)), np.zeros((1, 3)), np.pi * np.eye(3), -np.pi * np.eye(3)]
)


def test_axis_angles_become_the_quaternions_of_scipy() -> None:
    expected = Rotation.from_rotvec(VECTORS).as_quat(scalar_first=True)
    assert np.allclose(from_axis_angle(VECTORS), expected, rtol=0, atol=1e-15)


def test_matrices_there_and_back_lose_nothing_at_half_turns_either() -> None:
    matrices = Rotation.from_rotvec(VECTORS).as_matrix()
    assert np.allclose(rotation_matrices(from_matrices(matrices)), matrices, rtol=0, atol=1e-14)
    assert np.allclose(rotation_matrices(from_axis_angle(VECTORS)), matrices, rtol=0, atol=1e-14)
