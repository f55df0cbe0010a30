"""The SMPL fit of the Plus release, posed with a body model of the user's; here an invented one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, Joint
from prbench.sequences import CorpusTable
from prbench_adapters.corpora.build import build_corpus
from prbench_adapters.corpora.nymeria.suit import read_smpl_fit
from prbench_adapters.corpora.sources import CorpusOptions
from tests.fakes import STANDING

N_VERTICES = 24


def write_model(path: Path) -> Path:
    """Vertices that are the joints themselves; the first shape number lengthens everything by a tenth."""
    template = np.zeros((N_VERTICES, 3))
    template[:22] = STANDING
    shapes = np.zeros((N_VERTICES, 3, 10))
    shapes[..., 0] = 0.1 * template
    np.savez(path, J_regressor=np.eye(24, N_VERTICES), v_template=template, shapedirs=shapes)
    return path


def write_fit(path: Path, n: int = 1200, **changed: Any) -> Path:
    arrays: dict[str, Any] = {
        "betas": np.zeros((n, 10)),
        "body_pose": np.zeros((n, 69)),
        "global_orient": np.zeros((n, 3)),
        "transl": np.zeros((n, 3)),
        "timestamps": 7_000_000 + np.rint(np.arange(n) * 1e6 / 240).astype(np.int64),
    }
    np.savez(path, **(arrays | changed))
    return path


def read(tmp_path, **changed: Any):
    fit, model = write_fit(tmp_path / "fit.npz", **changed), write_model(tmp_path / "model.npz")
    return read_smpl_fit(fit, model, tolerance=0.001, shortest=2.0)


def test_the_rest_pose_is_the_models(tmp_path):
    (piece,) = read(tmp_path)
    np.testing.assert_allclose(piece.joints[17], STANDING, atol=1e-9)
    assert piece.start == 7.0


def test_the_root_turns_about_the_rest_pelvis_and_moves_by_transl(tmp_path):
    orient = np.tile([0.0, np.pi / 2, 0.0], (1200, 1))
    (piece,) = read(tmp_path, global_orient=orient, transl=np.tile([1.0, 0.0, 2.0], (1200, 1)))
    pelvis = STANDING[Joint.PELVIS] + [1.0, 0.0, 2.0]
    np.testing.assert_allclose(piece.joints[0, Joint.PELVIS], pelvis, atol=1e-9)
    offset = STANDING[Joint.LEFT_HIP] - STANDING[Joint.PELVIS]
    np.testing.assert_allclose(piece.joints[0, Joint.LEFT_HIP] - pelvis, [offset[2], offset[1], -offset[0]], atol=1e-9)


def test_a_bent_elbow_moves_the_wrist_alone(tmp_path):
    pose = np.zeros((1200, 23, 3))
    pose[:, Joint.LEFT_ELBOW - 1, 0] = -np.pi / 2
    (piece,) = read(tmp_path, body_pose=pose.reshape(1200, 69))
    still = [joint for joint in range(22) if joint != Joint.LEFT_WRIST]
    np.testing.assert_allclose(piece.joints[0, still], STANDING[still], atol=1e-9)
    forearm = piece.joints[0, Joint.LEFT_WRIST] - piece.joints[0, Joint.LEFT_ELBOW]
    before = STANDING[Joint.LEFT_WRIST] - STANDING[Joint.LEFT_ELBOW]
    np.testing.assert_allclose(forearm, [before[0], before[2], -before[1]], atol=1e-9)


def test_the_shape_scales_the_bones(tmp_path):
    betas = np.zeros((1200, 10))
    betas[:, 0] = 1.0
    (piece,) = read(tmp_path, betas=betas)
    for child in range(1, 22):
        bone = np.linalg.norm(piece.joints[0, child] - piece.joints[0, PARENTS[child]])
        assert bone == pytest.approx(1.1 * np.linalg.norm(STANDING[child] - STANDING[PARENTS[child]]))


def test_jumps_split_the_fit_too(tmp_path):
    times = 7_000_000 + np.rint(np.arange(1200) * 1e6 / 240).astype(np.int64)
    times[700:] += 50_000
    assert [len(piece.joints) for piece in read(tmp_path, timestamps=times)] == [700, 500]


def test_models_without_plain_arrays_are_refused_with_the_way_out(tmp_path):
    fit = write_fit(tmp_path / "fit.npz")
    (tmp_path / "model.pkl").write_bytes(b"\x80\x04N.")
    with pytest.raises(InputFileError, match="opens no pickles"):
        read_smpl_fit(fit, tmp_path / "model.pkl", tolerance=0.001, shortest=2.0)
    np.savez(tmp_path / "other.npz", v_template=np.zeros((3, 3)))
    with pytest.raises(InputFileError, match="J_regressor"):
        read_smpl_fit(fit, tmp_path / "other.npz", tolerance=0.001, shortest=2.0)


def test_a_corpus_of_fits(nymeria_tree, tmp_path):
    name = sorted(path.parent.parent.name for path in nymeria_tree.glob("*/body/xdata.npz"))[0]
    with np.load(nymeria_tree / name / "body" / "xdata.npz") as suit:
        times = suit["timestamps_us"]
    tree = tmp_path / "tree" / name.replace("_invented_", "_somebody_")  # without the mark of invented people
    (tree / "body").mkdir(parents=True)
    (tree / "narration").symlink_to(nymeria_tree / name / "narration")
    (tree / "body" / "xdata.npz").symlink_to(nymeria_tree / name / "body" / "xdata.npz")
    write_fit(tree / "body" / "xdata_smpl_neutral.npz", len(times), timestamps=times)
    options = CorpusOptions(source=(("body", "smpl"), ("smpl_model", str(write_model(tmp_path / "model.npz")))))
    report = build_corpus("nymeria", tmp_path / "tree", tmp_path / "out", options=options)
    rows = CorpusTable.open(report.folder).scalars()
    assert set(rows["pose_source"].to_pylist()) == {"nymeria-smpl"}
    assert str(tmp_path) not in str(report.info.options)
