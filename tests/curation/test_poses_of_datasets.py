"""EgoAllo as a step for HD-EPIC, whose inputs lie in archives, and HOT3D, whose lie beside the recording."""

from __future__ import annotations

import gzip
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from prbench.curation.poses import make_poses, pose_states, read_config
from prbench.curation.poses.states import prepare
from prbench.readers import reader_for
from prbench.readers.aria_mps.trajectory import read_trajectory
from prbench.synthetic.write_tree import synthesize_tree

FAKE = Path(__file__).with_name("fake_egoallo.py")
POINTS = gzip.compress(
    b"uid,graph_uid,px_world,py_world,pz_world,inv_dist_std,dist_std\n0,g,0.0,0.0,0.0,0.00001,0.001\n"
)


@pytest.fixture(scope="module")
def trees(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("aria")
    return {
        name: synthesize_tree(name, folder / name, recordings=1, seed=4, n_events=1).root
        for name in ("hd-epic", "hot3d")
    }


@pytest.fixture
def config(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("FAKE_CALLS", str(tmp_path / "calls.txt"))
    path = tmp_path / "egoallo.toml"
    path.write_text(
        f'[egoallo]\npython = "{sys.executable}"\nfolder = "."\ncommand = ["{{python}}", "{FAKE}", "--traj-root",'
        ' "{mps}", "--traj-length", "{frames}", "--guidance-mode", "{guidance}", "--recording", "{recording}"]\n'
    )
    return path


def _without_bodies(trees: dict[str, Path], dataset: str, tmp_path: Path) -> tuple[Path, str]:
    """A copy of a tree without EgoAllo's outputs, with a VRS file and points where the real ones have them."""
    root = shutil.copytree(trees[dataset], tmp_path / dataset)
    for folder in root.rglob("egoallo_outputs"):
        shutil.rmtree(folder)
    (found,) = reader_for(dataset).find(root)
    name = found.recording_id
    if dataset == "hot3d":
        (found.folder / "recording.vrs").write_bytes(b"VRS")
        (found.folder / "mps" / "slam" / "semidense_points.csv.gz").write_bytes(POINTS)
        return root, name
    (archive,) = root.rglob("SLAM/multi/*.zip")
    with zipfile.ZipFile(archive, "a") as opened:
        (trajectory,) = (entry for entry in opened.namelist() if entry.endswith("closed_loop_trajectory.csv"))
        opened.writestr(f"{trajectory.rpartition('/')[0]}/semidense_points.csv.gz", POINTS)
    vrs = archive.parents[4] / "VRS" / archive.parents[2].name / f"{name}_anonymized.vrs"
    vrs.parent.mkdir(parents=True)
    vrs.write_bytes(b"VRS")
    return root, name


@pytest.mark.parametrize(("dataset", "guidance"), [("hd-epic", "aria_wrist_only"), ("hot3d", "no_hands")])
def test_bodies_are_made_from_what_the_dataset_has(trees, config, tmp_path, dataset, guidance):
    root, name = _without_bodies(trees, dataset, tmp_path)
    (state,) = pose_states(root)
    assert state.state == "missing"
    (outcome,) = make_poses([state], read_config(config), root=root)
    assert outcome.state == "made", outcome.message
    assert (tmp_path / "calls.txt").read_text().split()[::2] == [name, guidance]
    (again,) = pose_states(root)
    assert again.state == "complete"
    reader = reader_for(dataset)
    recording = reader.read(reader.find(root)[0])
    assert recording.body is not None
    assert recording.pose_source == "egoallo"


def test_poses_can_be_kept_outside_of_the_dataset(trees, config, tmp_path):
    root, name = _without_bodies(trees, "hot3d", tmp_path)
    elsewhere = {"poses_root": tmp_path / "poses"}
    make_poses(tuple(pose_states(root, "hot3d", **elsewhere)), read_config(config), root=root)
    assert list((tmp_path / "poses" / name / "egoallo_outputs").glob("*.npz"))
    reader = reader_for("hot3d", {"poses_root": str(tmp_path / "poses")})
    assert reader.read(reader.find(root)[0]).body is not None
    assert next(pose_states(root, "hot3d", **elsewhere)).state == "complete"
    assert next(pose_states(root)).state == "missing"


def test_poses_of_other_worlds_are_left_out_of_what_egoallo_sees(trees, tmp_path):
    root, _ = _without_bodies(trees, "hot3d", tmp_path)
    (path,) = root.rglob("mps/slam/closed_loop_trajectory.csv")
    header, *rows = path.read_text().splitlines()
    rows[:50] = [f"UNDEFINED_ROW,{row.partition(',')[2]}" for row in rows[:50]]
    path.write_text("\n".join([header, *rows]) + "\n")
    (found,) = reader_for("hot3d").find(root)
    trajectory, _ = prepare(reader_for("hot3d").egoallo_inputs(root, found), tmp_path / "prepared")
    written = read_trajectory(trajectory)
    assert len(written.time_us) == len(rows) - 50
    np.testing.assert_array_equal(written.position, read_trajectory(path).position)
    np.testing.assert_array_equal(written.rotation, read_trajectory(path).rotation)


def test_what_is_not_there_is_named(trees, config, tmp_path):
    root, _ = _without_bodies(trees, "hd-epic", tmp_path)
    shutil.rmtree(next(root.rglob("VRS")))
    (outcome,) = make_poses(tuple(pose_states(root)), read_config(config), root=root)
    assert outcome.failed
    assert "VRS recording" in outcome.message
    assert not (tmp_path / "calls.txt").exists()
