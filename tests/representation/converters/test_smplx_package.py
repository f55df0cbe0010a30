"""The package ``smplx`` as an independent oracle of the light path; and its unpickling, which must never happen."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from prbench.errors import InputFileError, MissingExtraError
from prbench.representation.converters import SmplParameters, SmplxModel, read_rest_joints, smpl_joints
from tests.representation.converters.bodies import write_body_model


def parameters(frames: int = 5, shapes: int = 10) -> SmplParameters:
    rng = np.random.default_rng(3)
    return SmplParameters.from_poses(
        rng.normal(size=(frames, 66)) * 0.5, rng.normal(size=(frames, 3)), betas=rng.normal(size=shapes)
    )


@pytest.fixture
def smplx(monkeypatch):
    """The package, with its surface points on the first vertex, so that models of a few points fit."""
    package = pytest.importorskip("smplx", reason="pip install 'prbench[smplx]'")
    known = package.body_models.VERTEX_IDS
    small = {model: dict.fromkeys(points, 0) for model, points in known.items()}
    monkeypatch.setattr(package.body_models, "VERTEX_IDS", small)
    return package


@pytest.mark.parametrize(("joints", "shapes"), [(24, 10), (24, 300), (52, 16), (55, 20), (55, 400)])
def test_both_paths_agree_on_invented_models_of_each_kind(tmp_path, smplx, joints, shapes) -> None:
    path = tmp_path / "model.npz"
    write_body_model(path, joints=joints, shapes=shapes, seed=joints)
    light = smpl_joints(parameters(), read_rest_joints(path))
    full = SmplxModel.read(path).joints(parameters())
    assert np.ptp(light) > 1.0
    assert np.abs(light - full).max() < 1e-6


def test_long_motions_are_posed_in_parts(tmp_path, smplx) -> None:
    path = tmp_path / "model.npz"
    write_body_model(path, joints=24)
    moving = parameters(frames=130)
    assert np.allclose(SmplxModel.read(path).joints(moving), smpl_joints(moving, read_rest_joints(path)), atol=1e-6)


def test_nothing_is_unpickled(tmp_path, smplx, monkeypatch) -> None:
    """The invented SMPL-X file holds an array of objects, as the official one does."""
    import pickle

    def refuse(*_args, **_words):
        raise AssertionError("something was unpickled")

    path = tmp_path / "model.npz"
    write_body_model(path, joints=55, shapes=20)
    monkeypatch.setattr(pickle, "load", refuse)
    monkeypatch.setattr(pickle, "loads", refuse)
    SmplxModel.read(path).joints(parameters())


def test_the_package_s_limit_on_shapes_is_told_and_not_hidden(tmp_path, smplx) -> None:
    path = tmp_path / "model.npz"
    write_body_model(path, joints=52, shapes=16)
    assert smpl_joints(parameters(shapes=16), read_rest_joints(path)).shape == (5, 22, 3)
    with pytest.raises(InputFileError, match="takes no more from this model, found 16"):
        SmplxModel.read(path).joints(parameters(shapes=16))


def test_nothing_is_printed(tmp_path, smplx, capsys) -> None:
    path = tmp_path / "model.npz"
    write_body_model(path, joints=24)
    SmplxModel.read(path).joints(parameters())
    assert capsys.readouterr().out == ""


def test_a_model_without_its_hands_is_sent_to_the_light_path(tmp_path, smplx) -> None:
    path = tmp_path / "model.npz"
    write_body_model(path, joints=52)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if not name.startswith("hands")}
    np.savez(path, **arrays)
    with pytest.raises(InputFileError, match=r"hands_componentsl.*smpl_joints needs no hands"):
        SmplxModel.read(path)


def test_without_the_package_the_pip_line_is_named(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "smplx", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'prbench\[smplx\]'"):
        SmplxModel.read(tmp_path / "model.npz")
