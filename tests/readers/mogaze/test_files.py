"""Reading MoGaze's folder: what is found, how bodies get names and boxes, and what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from prbench.curation import BuildOptions, CurationOptions, build_dataset
from prbench.errors import RecordingUnusable
from prbench.readers import reader_for
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.files import extents, find_mesh, read_mesh, read_scene
from prbench.readers.mogaze.format import STATE_COLUMNS
from prbench.readers.mogaze.synthetic import box_mesh
from prbench.recording import Recording
from tests.laws.readers_cases import replace_rows
from tests.recording.mogaze_scene import CUP, NAMES, PLATE, TABLE, N, write_names, write_scene


@pytest.fixture
def root(tmp_path) -> Path:
    return write_scene(tmp_path)


def _read(root: Path, **options: str) -> Recording:
    reader = reader_for("mogaze", options)
    (found,) = reader.find(root)
    return reader.read(found)


def test_a_recording_in_its_folder_above_it_or_by_one_of_its_files(root) -> None:
    reader = reader_for("mogaze")
    (found,) = reader.find(root)
    assert (found.recording_id, found.dataset, found.skip_reason) == ("p1_1", "mogaze", None)
    assert {file.role for file in found.files} == {*mogaze.PARTS, "scene", "mesh:meshfiles/cup.obj"}
    assert reader.find(root.parent) == reader.find(root)
    assert reader.find(root / "p1_1_gaze_data.hdf5") == reader.find(root)
    assert _read(root).participant_id == "p1"


def test_stray_files_are_no_recordings(root) -> None:
    for name in ("p7_1_objects.hdf5", "p7_1_objects.csv", "p1_1_instructions.csv", "p1_1_human_data.hdf5.part"):
        (root / name).write_bytes(b"")
    assert [found.recording_id for found in reader_for("mogaze").find(root)] == ["p1_1"]


def test_boxes_come_from_meshes_then_from_the_table_then_are_points(root) -> None:
    write_names(root, NAMES | {TABLE: "spaceship"}, {CUP: "mogaze/meshfiles/cup.obj"})
    recording = _read(root)
    cup, plate, ship = (recording.object(str(key)) for key in (CUP, PLATE, TABLE))
    assert (cup.box_min.tolist(), cup.box_max.tolist()) == ([-0.1, -0.2, -0.3], [0.1, 0.2, 0.4])
    assert (plate.box_min.tolist(), plate.box_max.tolist()) == ([-0.092, -0.092, 0.0], [0.092, 0.092, 0.007])
    assert ship.box_min.tolist() == ship.box_max.tolist() == [0.0, 0.0, 0.0]
    assert recording.messages == ("no mesh and no known size, so a point instead of a box: spaceship",)


@pytest.mark.parametrize(
    ("source", "place"),
    [
        ("mogaze/meshfiles/cup.obj", "mogaze/meshfiles/cup.obj"),
        ("meshfiles/cup.obj", "mogaze/meshfiles/cup.obj"),
        ("other_name/cup.obj", "mogaze/meshfiles/cup.obj"),
        ("..\\elsewhere\\cup.obj", "mogaze/meshfiles/cup.obj"),
        ("../secret.obj", None),
        ("secret.obj", None),
        ("{root}/secret.obj", None),
        ("mogaze/meshfiles/jug.obj", None),
    ],
)
def test_where_a_mesh_is_looked_for_and_that_no_path_leads_out(root, source, place) -> None:
    (root.parent / "secret.obj").write_text(box_mesh(np.zeros(3), np.ones(3)))
    found = find_mesh(root, source.format(root=root.parent))
    assert found == (None if place is None else root.parent / place)


def test_a_link_out_of_the_folder_is_not_followed(root) -> None:
    (root.parent / "secret.obj").write_text(box_mesh(np.zeros(3), np.ones(3)))
    (root / "meshfiles" / "jug.obj").symlink_to(root.parent / "secret.obj")
    assert find_mesh(root, "mogaze/meshfiles/jug.obj") is None


def test_a_mesh_is_read_again_after_it_changed(root) -> None:
    path = root / "meshfiles" / "cup.obj"
    assert read_mesh(path).max() == 0.4
    path.write_text(box_mesh(np.zeros(3), np.full(3, 0.125)))
    assert read_mesh(path).max() == 0.125


def test_a_body_without_a_name_keeps_its_number(root) -> None:
    write_names(root, {key: name for key, name in NAMES.items() if key != PLATE})
    assert _read(root).object(str(PLATE)).name == f"body_{PLATE}"


def test_names_may_be_bytes_or_text_and_columns_in_any_order(root) -> None:
    before = _read(root)
    order = np.arange(66)[::-1]
    with h5py.File(root / "p1_1_human_data.hdf5", "r+") as file:
        entry = file["data"]
        assert isinstance(entry, h5py.Dataset)
        entry[...] = np.array(entry)[:, order]
        names = [STATE_COLUMNS[index] for index in order]
        entry.attrs.create("description", names, dtype=h5py.string_dtype())
    after = _read(root)
    assert before.body is not None
    assert after.body is not None
    assert np.array_equal(before.body.joints, after.body.joints)


def test_streams_are_cut_to_the_shortest_with_a_word_beyond_two_frames(root) -> None:
    recording = _read(root)  # the gaze file has one row more, as in the release
    assert (len(recording.gaze.times), recording.messages) == (N, ())
    replace_rows("object_data", f"bodies/body {CUP}", np.tile((0, 0, 0, 0, 0, 0, 1.0), (N - 3, 1)))(root)
    recording = _read(root)
    assert len(recording.gaze.times) == len(recording.objects[0].times) == N - 3
    assert recording.messages[0] == f"cut to {N - 3} frames of object_data, body {CUP}; gaze_data has {N + 1}"


def test_streams_end_with_their_last_frame(root) -> None:
    (found,) = reader_for("mogaze").find(root)
    with h5py.File(root / f"p1_1_{mogaze.PARTS[0]}.hdf5", "r") as file:
        frames = len(file[mogaze.HUMAN_DATASET])
    (body_extent,) = [extent for extent in extents(found, None) if extent.stream == "body"]
    assert body_extent.last == pytest.approx((frames - 1) / mogaze.RATE)


def _copy_as(root: Path, name: str) -> None:
    for part in mogaze.PARTS:
        shutil.copy(root / f"p1_1_{part}.hdf5", root / f"{name}_{part}.hdf5")


def test_recordings_with_known_defects_are_skipped_with_their_reason(root, tmp_path) -> None:
    _copy_as(root, "p3_1")
    _copy_as(root, "p7_2")
    (root / "p3_1_gaze_data.hdf5").unlink()
    trusted = CurationOptions(shift=(("body", 0.0), ("gaze", 0.0)))  # nobody stands as still
    report = build_dataset("mogaze", root, tmp_path / "table", options=BuildOptions(curation=trusted))
    assert {record.recording_id: record.status for record in report.records} == {
        "p1_1": "read", "p3_1": "skipped", "p7_2": "skipped",
    }  # fmt: skip
    assert "not recorded" in report.records[1].message
    assert "include_excluded" in report.records[2].message
    kept = BuildOptions(reader=(("include_excluded", "true"),), curation=trusted)
    report = build_dataset("mogaze", root, tmp_path / "table", options=kept)
    assert [record.status for record in report.records] == ["read", "skipped", "read"]
    assert report.info.options["reader.include_excluded"] == "true"
    (found,) = (found for found in reader_for("mogaze").find(root) if found.recording_id == "p3_1")
    with pytest.raises(RecordingUnusable, match="not recorded"):
        reader_for("mogaze").read(found)


def test_scene_of_the_layout_is_read_back(root) -> None:
    assert {key: name for key, (name, _) in read_scene(root / "scene.xml")[0].items()} == NAMES


def test_a_synthetic_tree_is_recognised_from_the_folder_above_it(root) -> None:
    mark = {"generator": "", "version": 1, "seed": 0, "preset": "mogaze", "world": "default", "split": {"p1_1": "test"}}
    (root / "synthetic.json").write_text(json.dumps(mark))
    for place in (root, root.parent):
        (found,) = reader_for("mogaze").find(place)
        assert (found.dataset, found.split) == ("synthetic-mogaze", "test")
