"""What stands around a sequence: objects at their places, point clouds in the same frame, and what a licence keeps."""

from __future__ import annotations

import gzip
import importlib.util
import shutil
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.cli import main
from prbench.curation import build_dataset
from prbench.errors import InputFileError, MissingExtraError, UsageError
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, invert_rigid, transform_points
from prbench.sequences import SequenceChunk, SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from prbench.viewing.replay.read import scene_of
from prbench.viewing.replay.scene import METHOD_COLOURS, ShownMotion
from prbench.viewing.view import Surroundings
from tests.fakes import fake_dataset

needs_open3d = pytest.mark.skipif(importlib.util.find_spec("open3d") is None, reason="needs the extra open3d")
HEADER = "uid,graph_uid,px_world,py_world,pz_world,inv_dist_std,dist_std\n"


@pytest.fixture(scope="module")
def copies(tmp_path_factory) -> dict[str, tuple[Path, SequenceTable]]:
    """A synthetic copy of two datasets, and the table of each."""
    place = tmp_path_factory.mktemp("copies")
    made = {}
    for name in ("adt", "hot3d"):
        root = synthesize_tree(name, place / name, recordings=1, seed=1, n_events=4).root
        build_dataset(name, root, place / f"table_{name}")
        made[name] = root, SequenceTable.open(place / f"table_{name}")
    return made


def _first(table: SequenceTable) -> SequenceChunk:
    return next(table.chunks(rows=1))


def _world_from_canonical(chunk: SequenceChunk) -> np.ndarray:
    return chunk.vectors("world_from_canonical").reshape(4, 4)


def _write_points(path: Path, points: np.ndarray, *, dist_std: float) -> None:
    rows = "".join(f"{n},g,{x},{y},{z},0.0001,{dist_std}\n" for n, (x, y, z) in enumerate(points))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress((HEADER + rows).encode()))


@needs_open3d
@pytest.mark.parametrize("name", ["adt", "hot3d"])
def test_the_object_lies_in_the_goal_s_box_when_the_event_comes(copies, name) -> None:
    root, table = copies[name]
    surroundings = Surroundings(table.info.dataset, root)
    for chunk in table.chunks(rows=1):
        world = transform_points(_world_from_canonical(chunk), surroundings.around(chunk))
        low = chunk.vectors("goal_box_world_min")[0]
        high = chunk.vectors("goal_box_world_max")[0]
        inside = world[((world > low - 0.02) & (world < high + 0.02)).all(axis=1)]
        assert len(inside) > 20
        assert np.ptp(inside, axis=0) == pytest.approx(high - low, abs=0.05)


@needs_open3d
def test_points_are_two_centimetres_apart_near_the_body_and_the_same_in_every_run(copies) -> None:
    root, table = copies["adt"]
    chunk = _first(table)
    points = Surroundings(table.info.dataset, root).around(chunk)
    cells = np.unique(np.floor(points / 0.02), axis=0)
    assert len(cells) > 0.4 * len(points)
    assert points[:, 1].min() > 0.0
    assert np.abs(points - chunk.joints[:, 0].mean(axis=0)).max() < 5.0
    np.testing.assert_array_equal(points, Surroundings(table.info.dataset, root).around(chunk))


@needs_open3d
@pytest.mark.parametrize(
    ("name", "folder", "native_from_world"),
    [("adt", "mps/slam", np.eye(4)), ("hot3d", "mps/slam", invert_rigid(Y_UP_FROM_Z_UP))],
)
def test_sure_points_of_a_cloud_stand_in_the_frame_of_the_motion(
    copies, tmp_path, name, folder, native_from_world
) -> None:
    root, table = copies[name]
    copy = tmp_path / "copy"
    shutil.copytree(root, copy)
    chunk = _first(table)
    canonical = np.array([[0.5, 1.93, 0.1], [-0.5, 1.93, 0.2]])  # above all furniture
    native = transform_points(native_from_world @ _world_from_canonical(chunk), canonical)
    surroundings = Surroundings(table.info.dataset, copy)
    place = surroundings._found[chunk.strings("recording_id")[0]].folder / folder / "semidense_points.csv.gz"
    _write_points(place, native, dist_std=0.01)
    points = surroundings.around(chunk)
    assert all(np.linalg.norm(points - point, axis=1).min() < 1e-6 for point in canonical)
    _write_points(place, native, dist_std=0.2)
    points = Surroundings(table.info.dataset, copy).around(chunk)
    assert all(np.linalg.norm(points - point, axis=1).min() > 0.1 for point in canonical)
    place.write_bytes(gzip.compress(b"x,y,z\n1,2,3\n"))
    with pytest.raises(InputFileError, match=r"semidense_points.csv.gz: expected points with the columns px_world"):
        Surroundings(table.info.dataset, copy).around(chunk)


@needs_open3d
def test_the_command_draws_it_and_refuses_another_copy(copies, tmp_path, capsys) -> None:
    root, table = copies["adt"]
    words = ["view", "--data", str(table.folder), "--limit", "1", "--out", str(tmp_path / "a.png")]
    assert main([*words, "--scene", str(root)]) == 0
    other = synthesize_tree("adt", tmp_path / "other", recordings=1, seed=2, n_events=2).root
    capsys.readouterr()
    assert main([*words, "--scene", str(other)]) == UsageError.exit_code
    assert "expected the recording" in capsys.readouterr().err


def test_without_open3d_the_command_says_how_to_install_it(copies, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"--scene needs .*pip install 'prbench\[open3d\]'"):
        Surroundings("adt", copies["adt"][0])


def test_where_the_licence_keeps_recorded_motion_it_keeps_its_surroundings(tmp_path) -> None:
    table = fake_dataset(tmp_path / "t", n=3)
    chunk = _first(table)
    around = np.ones((4, 3))
    assert scene_of(chunk, table.info, around=lambda _: around).surroundings is around
    kept = msgspec.structs.replace(table.info, redistribution="none")
    generated = ShownMotion("static", METHOD_COLOURS[0], chunk.joints.astype(np.float64))
    assert scene_of(chunk, kept, [generated], around=lambda _: around).surroundings is None
