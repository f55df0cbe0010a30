"""SMPL, SMPL-H and SMPL-X parameters to joints, with NumPy alone."""

from __future__ import annotations

import pickle
import shlex
import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError, UsageError
from prbench.geometry.skeleton import z_up
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
from prbench.representation.converters.smpl import HOW_TO_CONVERT, numbers_of
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


@pytest.mark.parametrize(
    ("values", "form", "message"),
    [
        (np.full((2, 3), 120.0), "axis-angle", "look like degrees"),
        (np.full((2, 4), 2.0), "quaternion-wxyz", "unit quaternions, found one of the length 4"),
        (np.diag([1.0, 1.0, -1.0]).reshape(1, 9), "matrix", "determinant is -1"),
        (np.zeros((2, 7)), "6d-rows", "a multiple of 6"),
        (np.array([[1.0, 0, 0, 2.0, 0, 0]]), "6d-columns", r"two directions that lie along one another"),
        (np.array([[0.0, np.nan, 0.0]]), "axis-angle", "frame 0: expected finite"),
    ],
)
def test_numbers_that_are_no_rotations_are_refused(values, form, message) -> None:
    with pytest.raises(InputFileError, match=message):
        quaternions_of(values, form)


def test_an_unknown_form_is_answered_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="Did you mean '6d-rows'"):
        numbers_of("6d_rows")


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


def test_missing_or_short_arrays_are_named() -> None:
    with pytest.raises(InputFileError, match="22 or more rotations of 3 numbers"):
        SmplParameters.from_poses(np.zeros((5, 63)), np.zeros((5, 3)))
    with pytest.raises(InputFileError, match="body_pose: expected 5 frames"):
        SmplParameters.from_arrays(global_orient=np.zeros((5, 3)), body_pose=np.zeros((4, 63)), transl=np.zeros((5, 3)))
    with pytest.raises(InputFileError, match="transl"):
        SmplParameters.from_poses(np.zeros((5, 66)), np.full((5, 3), np.inf))
    with pytest.raises(InputFileError, match="betas"):
        SmplParameters.from_poses(np.zeros((5, 66)), np.zeros((5, 3)), betas=np.full(10, np.nan))


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
    with pytest.raises(InputFileError, match="at most the 10 shape numbers"):
        read_rest_joints(path).of(np.ones(16))


def test_shape_numbers_of_zero_beyond_the_model_s_are_harmless(tmp_path) -> None:
    path = tmp_path / "model.npz"
    write_body_model(path, joints=24)
    betas = np.r_[np.ones(10), np.zeros(6)]
    assert np.array_equal(read_rest_joints(path).of(betas), read_rest_joints(path).of(betas[:10]))


class _Bomb:
    def __reduce__(self):
        return (RuntimeError, ("was unpickled",))


def test_a_pickle_is_refused_unread_with_the_way_to_convert_it(tmp_path) -> None:
    path = tmp_path / "SMPL_NEUTRAL.pkl"
    path.write_bytes(pickle.dumps(_Bomb()))
    with pytest.raises(InputFileError, match=r"opens no pickles\. Convert the licensed file once"):
        read_rest_joints(path)
    (tmp_path / "renamed.npz").write_bytes(pickle.dumps(_Bomb()))
    with pytest.raises(InputFileError, match=r"a readable \.npz file, .*opens no pickles\. Convert"):
        read_rest_joints(tmp_path / "renamed.npz")


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


def test_an_array_of_objects_is_refused_unread(tmp_path) -> None:
    path = tmp_path / "model.npz"
    bomb = np.empty(1, dtype=object)
    bomb[0] = _Bomb()
    np.savez(path, v_template=np.zeros((60, 3)), shapedirs=np.zeros((60, 3, 10)), J_regressor=bomb, other=bomb)
    with pytest.raises(InputFileError, match="expected numbers or text, found Python objects"):
        read_rest_joints(path)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"v_template": np.zeros((60, 3))}, "an array 'J_regressor'"),
        (
            {"v_template": np.zeros((60, 3)), "J_regressor": np.zeros((16, 60)), "shapedirs": np.zeros((60, 3, 10))},
            "the model of another body",
        ),
    ],
)
def test_files_of_other_models_are_refused(tmp_path, arrays, message) -> None:
    np.savez(tmp_path / "model.npz", **arrays)
    with pytest.raises(InputFileError, match=message):
        read_rest_joints(tmp_path / "model.npz")


def test_a_missing_model_says_where_it_comes_from(tmp_path) -> None:
    with pytest.raises(InputFileError, match="prbench ships none"):
        read_rest_joints(tmp_path / "SMPLX_NEUTRAL.npz")


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


def test_an_amass_file_without_poses_is_named(tmp_path) -> None:
    np.savez(tmp_path / "clip.npz", trans=np.zeros((3, 3)))
    with pytest.raises(InputFileError, match="an array 'poses'"):
        read_amass(tmp_path / "clip.npz")
