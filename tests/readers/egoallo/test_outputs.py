"""Every damage of docs/specification/egoallo.md#bad-input, refused with file, key, expected, found and remedy."""

from __future__ import annotations

import io

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.readers.egoallo.bodies import read_output, read_smplh_rest
from tests.readers.egoallo_files import model, output, rewrite, write


@pytest.fixture
def path(tmp_path):
    return write(tmp_path, output())


def _nan(array: np.ndarray) -> np.ndarray:
    changed = array.copy()
    changed.reshape(-1)[17] = np.nan
    return changed


GOOD = output()
NOT_UNIT = GOOD.body_quats.copy()
NOT_UNIT[0, 3, 4] *= 1.002
BACKWARDS = GOOD.time_ns.copy()
BACKWARDS[5] = BACKWARDS[4]

DAMAGES = {
    "no betas": ({"betas": None}, "an array 'betas'"),
    "no times": ({"timestamps_ns": None}, "an array 'timestamps_ns'"),
    "no root": ({"Ts_world_root": None}, "an array 'Ts_world_root'"),
    "no frames": ({"timestamps_ns": np.zeros(0, dtype=np.int64)}, "T = 0"),
    "no samples": ({"Ts_world_root": np.zeros((0, 12, 7), dtype=np.float32)}, "S = 0"),
    "fewer roots": ({"Ts_world_root": GOOD.world_from_root[:, :11]}, "Ts_world_root: expected floats of the shape"),
    "other samples": ({"betas": np.tile(GOOD.betas, (2, 1, 1))}, "betas: expected floats of the shape"),
    "51 rotations": ({"body_quats": np.ones((1, 12, 51, 4), dtype=np.float32)}, "float32 (1, 12, 51, 4)"),
    "NaN in the body": ({"body_quats": _nan(GOOD.body_quats)}, "body_quats[0, 0, 4, 1]: expected finite numbers"),
    "NaN in the head": ({"Ts_world_cpf": _nan(GOOD.world_from_cpf)}, "Ts_world_cpf"),
    "a long quaternion": ({"body_quats": NOT_UNIT}, "body_quats[0, 3, 4]: expected a quaternion of length 1"),
    "repeated time": ({"timestamps_ns": BACKWARDS}, "timestamps_ns, frame 5"),
    "times as floats": ({"timestamps_ns": GOOD.time_ns / 1.0}, "integers (T,)"),
    "objects": ({"betas": np.array([None], dtype=object)}, "numbers or text, found Python objects"),
}


@pytest.mark.parametrize(("changed", "said"), DAMAGES.values(), ids=DAMAGES)
def test_damage_is_refused(path, changed, said):
    rewrite(path, **changed)
    with pytest.raises(InputFileError) as error:
        read_output(path)
    assert str(path) in str(error.value)
    assert said in str(error.value)
    assert "prbench poses egoallo" in str(error.value)


def test_a_truncated_file_is_refused(path):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputFileError, match="may be truncated"):
        read_output(path)


def test_another_kind_of_file_is_refused(path):
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    for content in (b"", b"<html>not found</html>", buffer.getvalue()):
        path.write_bytes(content)
        with pytest.raises(InputFileError, match=r"a readable \.npz file"):
            read_output(path)


def test_contacts_and_fingers_may_be_absent(path):
    rewrite(path, contacts=None, left_hand_quats=None, right_hand_quats=None, frame_nums=None)
    assert len(read_output(path).time_ns) == 12


def test_a_slightly_long_quaternion_is_taken(path):
    rewrite(path, body_quats=(GOOD.body_quats * np.float32(1.0005)))
    assert len(read_output(path).time_ns) == 12


MODEL_DAMAGES = {
    "no regressor": ({"J_regressor": None}, "an array 'J_regressor'"),
    "ten shapes": ({"shapedirs": np.zeros((52, 3, 10))}, "at least 16 shapes"),
    "SMPL": ({"J_regressor": np.zeros((24, 52))}, "J_regressor (52, v)"),
    "objects": ({"J_regressor": np.array([None], dtype=object)}, "found Python objects"),
}


@pytest.mark.parametrize(("changed", "said"), MODEL_DAMAGES.values(), ids=MODEL_DAMAGES)
def test_a_wrong_body_model_is_refused(tmp_path, changed, said):
    path = model(tmp_path)
    rewrite(path, **changed)
    with pytest.raises(InputFileError) as error:
        read_smplh_rest(path)
    assert str(path) in str(error.value)
    assert said in str(error.value)


def test_a_missing_body_model_is_explained(tmp_path):
    with pytest.raises(InputFileError, match=r"Extended SMPL\+H model.*smplh_model=FILE"):
        read_smplh_rest(tmp_path / "model.npz")
