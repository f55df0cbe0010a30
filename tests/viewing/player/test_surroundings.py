"""Objects and scenes of recordings: where they stand beside the motion, and how a mesh becomes small."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from prbench.cli import main
from prbench.curation import build_dataset
from prbench.geometry.skeleton import transform_points
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from prbench.viewing.player.surroundings import decimated
from prbench.viewing.review import native_recordings
from tests.shared import made_once
from tests.viewing.player.test_document import array


def made(dataset: str) -> Path:
    """Two synthetic recordings of a dataset below ``raw``, and their table ``table``."""

    def make(place: Path) -> None:
        synthesize_tree(dataset, place / "raw", recordings=2, seed=4, n_events=2)
        build_dataset(dataset, place / "raw", place / "table")

    return made_once(f"reviewed-{dataset}", make)


def documents(out: Path) -> list[dict]:
    found = re.findall(r'class="sequence">(.*?)</script>', out.read_text(encoding="utf-8"), flags=re.DOTALL)
    return list(map(json.loads, found))


def viewed(place: Path, out: Path, *more: str) -> list[dict]:
    words = ["view", "--data", str(place / "table"), "--root", str(place / "raw"), "--out", str(out), *more]
    assert main(words) == 0
    return documents(out)


def test_the_box_of_the_goal_stands_where_the_goal_is_and_is_carried_away(tmp_path):
    place = made("adt")
    table = SequenceTable.open(place / "table")
    for document in viewed(place, tmp_path / "page.html"):
        (chunk,) = table.chunks(ids=frozenset([document["sequence_id"]]))
        name = chunk.strings("object_name")[0]
        own = [each for each in document["objects"] if each["name"] == name]
        assert own, "the object of the event is among those around"
        places = []
        for each in own:
            place_now = np.mean(each["box"], axis=0)
            if each["path"] is not None:
                path = array(each["path"]).reshape(-1, 3) / 1000
                assert len(path) == document["n_frames"]
                np.testing.assert_allclose(path[0], place_now, atol=0.001)
                place_now = path[-1]
            places.append(np.linalg.norm(place_now - document["goal"]["location"]))
        # At the event the object rests, but for what its detection is late.
        assert min(places) < 0.1


def scan_of(place: Path, folder: Path | None) -> tuple[Path, np.ndarray]:
    """A mesh at the goal of the first sequence in the coordinates of the scan, by default in the dataset's own place.

    Returns the mesh, and where it has to appear.
    """
    table = SequenceTable.open(place / "table")
    chunk = next(table.chunks(rows=1))
    sources, _ = native_recordings(table.info, place / "raw")
    source = sources[chunk.strings("recording_id")[0]]
    recording = source.read()
    own = next(file.path.parent for file in source.found.files if file.path.name == "transform_norm.txt")
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.3)
    goal = chunk.vectors("goal_location")[0].astype(np.float64)
    placed = ball.vertices + goal
    world = transform_points(chunk.vectors("world_from_canonical").reshape(4, 4).astype(np.float64), placed)
    # The scan has a scale of its own, so that its inverse is no rigid one.
    linear = np.linalg.inv(recording.world_from_source)
    path = (folder or own) / "scene_downsampled.ply"
    trimesh.Trimesh(transform_points(linear, world), ball.faces, process=False).export(path)
    return path, placed


@pytest.mark.parametrize("named", [True, False])
def test_the_scan_of_a_scene_stands_where_it_was_scanned(named, tmp_path):
    place = made("gimo")
    first = next(SequenceTable.open(place / "table").chunks(rows=1))
    scan, placed = scan_of(place, tmp_path if named else None)
    try:
        options = ["--mesh", str(scan)] if named else []
        shown = viewed(place, tmp_path / "page.html", "--sequence", first.sequence_ids[0], *options)
    finally:
        scan.unlink()
    mesh = shown[0]["mesh"]
    vertices = array(mesh["vertices"]).reshape(-1, 3) / 1000
    nearest = np.linalg.norm(vertices[:, None] - placed, axis=2)
    assert nearest.min(axis=1).max() < 0.002
    assert len(array(mesh["triangles"], "<u4")) == 3 * 80


def test_a_large_mesh_keeps_its_shape_with_few_triangles():
    ball = trimesh.creation.icosphere(subdivisions=5)  # 20,480 triangles
    vertices, triangles = decimated(np.array(ball.vertices), np.array(ball.faces), 2_000)
    assert 500 < len(triangles) <= 2_000
    assert triangles.max() < len(vertices)
    radius = np.linalg.norm(vertices, axis=1)
    assert (radius.min(), radius.max()) == (pytest.approx(1.0, abs=0.1), pytest.approx(1.0, abs=0.01))
    few = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]])
    kept, one = decimated(*few, 2_000)
    assert kept[one[0]].tolist() == few[0].tolist()
    assert len(decimated(few[0], few[1][:0], 2_000)[1]) == 0  # where nothing of a scene is near


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["--mesh", "a.ply"], 2, "--root DIR"),
        (["--root", "{raw}", "--mesh", "{tmp}/cloud.ply"], 3, "cloud.ply: expected triangles with finite corners"),
        (["--root", "{raw}", "--mesh", "{tmp}/cut.ply"], 3, "cut.ply: expected a mesh of triangles"),
        (["--root", "{raw}", "--mesh", "{tmp}/none.glb"], 3, "none.glb"),
        (["--root", "{raw}", "--out", "a.png"], 2, "a page (.html)"),
        (["--root", "{table}", "--out", "a.html"], 3, "recording"),
    ],
)
def test_recordings_that_do_not_fit_are_told(words, code, told, tmp_path, capsys):
    place = made("adt")
    trimesh.PointCloud(np.zeros((3, 3))).export(tmp_path / "cloud.ply")
    (tmp_path / "cut.ply").write_bytes(b"ply\n")
    given = [word.format(raw=place / "raw", table=place / "table", tmp=tmp_path) for word in words]
    assert main(["view", "--data", str(place / "table"), *given]) == code
    assert told in capsys.readouterr().err
