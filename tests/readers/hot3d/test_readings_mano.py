"""The MANO route: licensed models as arrays, never as pickles."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.axes import z_up
from prbench.readers import Reader, reader_for
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import hands as mano
from prbench.readers.hot3d.synthetic import sense
from prbench.recording import Recording
from prbench.synthetic.people import perform
from prbench.synthetic.sensors import Switches
from tests.readers.hot3d.test_hands_mano import invented_model
from tests.readers.hot3d_trees import first_seconds, write_tree


@pytest.fixture
def tree(tmp_path) -> Path:
    performance = perform("hot3d", seed=11, index=0, n_events=2, provocations={})
    readings = first_seconds(sense(performance, switches=replace(Switches(), hand_losses=False)), 1.0)
    folder = write_tree(readings, tmp_path / "hot3d")
    lines = []
    for time in readings.headset.time_ns.tolist():
        hand = {
            "pose": [0.1] * 15,
            "betas": [0.2] * 10,
            "wrist_xform": {"t_xyz": [1.0, 2.0, 3.0], "q_wxyz": [1.0, 0.0, 0.0, 0.0]},
        }
        lines.append(json.dumps({"timestamp_ns": time, "hand_poses": {"0": hand, "1": hand}}))
    (folder / hot3d.MANO_FILE).write_text("\n".join(lines) + "\n")
    return tmp_path / "hot3d"


def _arrays(seed: int) -> dict[str, Any]:
    """An invented model under the keys of MANO's file."""
    model = invented_model(mano.N_VERTICES, seed)
    parents = model.parents.copy()
    parents[0] = 2**32 - 1
    return {
        "v_template": model.template,
        "shapedirs": model.shape_directions,
        "posedirs": model.pose_directions,
        "weights": model.weights,
        "J_regressor": model.regressor,
        "kintree_table": np.stack([parents, np.arange(16)]),
        "hands_components": np.vstack([model.components, np.zeros((30, 45))]),
        "hands_mean": model.mean_pose,
        "f": np.zeros((1538, 3), dtype=np.int64),
    }


@pytest.fixture
def models(tmp_path) -> Path:
    folder = tmp_path / "mano"
    folder.mkdir()
    for seed, side in enumerate(("LEFT", "RIGHT")):
        np.savez(folder / f"MANO_{side}.npz", **_arrays(seed))
    return folder


def _reader(models: Path | None) -> Reader:
    options = {"hands": "mano"} | ({} if models is None else {"mano_models": str(models)})
    return reader_for("hot3d", options)


def _read(tree: Path, models: Path | None) -> Recording:
    reader = _reader(models)
    return reader.read(reader.find(tree)[0])


def test_hands_are_posed_by_the_user_s_model(tree, models) -> None:
    recording = _read(tree, models)
    for seed, hand in enumerate(recording.hand_streams("wrist")):
        model = invented_model(mano.N_VERTICES, seed)
        root = model.regressor[0] @ (model.template + model.shape_directions @ np.full(10, 0.2))
        assert z_up(hand.points)[0, 0] == pytest.approx(root + np.array([1.0, 2.0, 3.0])), "not the translation alone"
    assert {hand.points.shape[1] for hand in recording.hand_streams("hand_vertex")} == {mano.N_VERTICES}


def test_the_models_are_inputs_whose_change_is_noticed(tree, models) -> None:
    (found,) = _reader(models).find(tree)
    assert {file.path for file in found.files if file.role.startswith("mano model:")} == set(models.iterdir())


def test_umetrack_is_the_default_and_needs_no_model(tree) -> None:
    reader = reader_for("hot3d")
    assert {hand.points.shape[1] for hand in reader.read(reader.find(tree)[0]).hand_streams("hand_vertex")} == {80}


def test_without_models_the_message_says_how_to_make_them(tree, tmp_path) -> None:
    with pytest.raises(InputFileError, match=r"mano_models=FOLDER.*no folder was given.*np\.savez.*hands=umetrack"):
        _read(tree, None)
    with pytest.raises(InputFileError, match=r"empty.MANO_LEFT\.npz: expected the licensed MANO model"):
        _read(tree, tmp_path / "empty")


class _Trap:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_pickle_is_never_opened(tree, models, tmp_path) -> None:
    sprung = tmp_path / "sprung"
    (models / "MANO_LEFT.npz").write_bytes(pickle.dumps(_Trap(sprung)))
    with pytest.raises(InputFileError, match="opens no pickles"):
        _read(tree, models)
    trapped: dict[str, Any] = _arrays(0) | {"v_template": np.array([_Trap(sprung)], dtype=object)}
    np.savez(models / "MANO_LEFT.npz", **trapped)
    with pytest.raises(InputFileError, match="opens no pickles"):
        _read(tree, models)
    assert not sprung.exists()


@pytest.mark.parametrize(
    ("name", "value"),
    [("weights", np.zeros((778, 15))), ("hands_mean", np.array(["a"] * 45)), ("kintree_table", np.full((2, 16), 20))],
)
def test_a_model_of_another_kind_is_refused(tree, models, name, value) -> None:
    np.savez(models / "MANO_RIGHT.npz", **_arrays(1) | {name: value})
    with pytest.raises(InputFileError, match=f"MANO_RIGHT.npz, {name}"):
        _read(tree, models)


def test_a_single_array_is_no_model(tree, models) -> None:
    with open(models / "MANO_LEFT.npz", "wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(InputFileError, match=r"MANO_LEFT\.npz: expected a readable \.npz file"):
        _read(tree, models)


def test_poses_of_another_length_are_refused(tree, models) -> None:
    (path,) = tree.glob(f"*/{hot3d.MANO_FILE}")
    path.write_text(path.read_text().replace("0.1, 0.1]", "0.1]", 1).replace('"pose": [0.1, ', '"pose": [', 1))
    with pytest.raises(InputFileError, match="expected 15 and 10 numbers"):
        _read(tree, models)
