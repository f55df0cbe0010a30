"""Finding and reading HOT3D: where recordings lie, which can be used, what is refused.

Source: docs/specification/hot3d.md#pitfalls-and-bad-input.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.curation import BuildOptions, build_dataset
from prbench.curation.job import native_sources
from prbench.errors import InputFileError, RecordingUnusable
from prbench.readers import reader_for
from prbench.readers.hot3d import READER, Hot3dOptions, find_recordings, read_readings
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.files import read_mask
from prbench.readers.hot3d.synthetic import sense
from prbench.recording import Recording
from prbench.synthetic.people import perform
from prbench.synthetic.sensors import Switches
from tests.readers.damages import edit_json, replace_text, set_cell
from tests.readers.hot3d_trees import change_metadata, first_seconds, write_tree


@pytest.fixture(scope="module")
def readings() -> hot3d.Hot3dReadings:
    performance = perform("hot3d", seed=11, index=0, n_events=2, provocations={})
    return first_seconds(sense(performance, switches=replace(Switches(), hand_losses=False)), 2.0)


@pytest.fixture
def tree(readings, tmp_path) -> Path:
    write_tree(readings, tmp_path / "hot3d")
    return tmp_path / "hot3d"


@pytest.fixture
def folder(readings, tree) -> Path:
    return tree / readings.recording_id


def _read(root: Path) -> Recording:
    (found,) = READER.find(root)
    return READER.read(found)


@pytest.mark.parametrize(("below", "library"), [("", "assets"), ("Aria", "object_library"), ("Aria", "assets")])
def test_recordings_lie_below_the_root_or_one_level_deeper(readings, tmp_path, below, library) -> None:
    place = write_tree(readings, tmp_path / "root", folder=below, library=library)
    for root in {tmp_path / "root", place.parent, place}:
        (found,) = find_recordings(root, Hot3dOptions())
        assert (found.recording_id, found.dataset, found.skip_reason) == (readings.recording_id, "hot3d", None)
        assert {file.role for file in found.files} >= {"metadata", "objects", "trajectory", "gaze", "instances"}
        assert sum(file.role.startswith("model:") for file in found.files) == len(readings.objects)


def test_metadata_of_another_dataset_is_no_recording(tree, tmp_path) -> None:
    (tree / "Apartment_seq1").mkdir()
    (tree / "Apartment_seq1" / "metadata.json").write_text('{"gt_time_domain": "DEVICE_CAPTURE"}')
    assert len(find_recordings(tree, Hot3dOptions())) == 1


def test_quest_and_test_participants_are_reported_and_not_failed(readings, folder, tree, tmp_path) -> None:
    """Keyed on what the metadata says, never on names; their other files may be missing."""
    withheld = dict.fromkeys(("mano_hand_pose_gt", "object_pose_gt", "umetrack_hand_pose_gt"), False)
    for name, entries in {
        "P0001_quest": {"headset": "Quest3"},
        "P0002_withheld": {"gt_available_status": withheld},
        "P0002_withheld_hands": {"gt_available_status": {**withheld, "object_pose_gt": True}},
    }.items():
        (tree / name).mkdir()
        change_metadata(tree / name, **entries)
    folder.rename(tree / "P0004_named_like_a_test_participant")
    report = build_dataset("hot3d", tree, tmp_path / "out")
    status = {record.recording_id: (record.status, record.message) for record in report.records}
    assert [status[name][0] for name in sorted(status)] == ["skipped", "skipped", "skipped", "read"]
    assert "Quest3" in status["P0001_quest"][1]
    assert "objects and hands" in status["P0002_withheld"][1]
    assert "ground truth of hands" in status["P0002_withheld_hands"][1]
    assert report.info.counts.recordings_skipped == 3
    assert report.info.counts.recordings_failed == 0
    with pytest.raises(RecordingUnusable, match="Quest3"):
        READER.read(next(f for f in READER.find(tree) if f.recording_id == "P0001_quest"))


def test_uids_stay_text_and_headsets_are_no_objects(readings, folder, tree) -> None:
    """A uid with a leading zero is another one than without."""
    first, second = (entry.object_id for entry in readings.objects[:2])
    replace_text(hot3d.OBJECTS_FILE, first, "0123")(folder)
    edit_json("instance.json", lambda content: content[second].update(instance_type="headset"))(tree / "assets")
    recording = _read(tree)
    found = {track.object_id for track in recording.objects}
    assert "0123" in found
    assert second not in found
    assert any("without a name" in message and "0123" in message for message in recording.messages)


def test_columns_are_found_by_name_and_further_ones_do_not_matter(readings, folder, tree) -> None:
    path = folder / hot3d.OBJECTS_FILE
    lines = [line.split(",") for line in path.read_text().splitlines()]
    path.write_text("\n".join(",".join(["more", *row[::-1]]) for row in lines) + "\n")
    objects = read_readings(find_recordings(tree, Hot3dOptions())[0]).objects
    for found, written in zip(objects, readings.objects, strict=True):
        assert np.array_equal(found.rows.position, written.rows.position)
        assert np.array_equal(found.rows.rotation, written.rows.rotation)


def test_lines_that_do_not_parse_are_left_out_and_counted(folder, tree) -> None:
    path = folder / hot3d.UMETRACK_FILE
    lines = path.read_bytes().splitlines()
    lines[10:13] = [b'{"timestamp_ns": 1', b"\xff\xfe", b"{}"]  # lines 11 to 13
    path.write_bytes(b"\n".join(lines) + b"\n")
    (entry,) = _read(tree).unreadable
    assert (entry.file, entry.key) == (hot3d.UMETRACK_FILE, "line 11 and 2 more")


def test_a_hand_that_is_never_there_is_said_and_the_other_read(folder, tree) -> None:
    path = folder / hot3d.UMETRACK_FILE
    path.write_text(path.read_text().replace('"1":', '"nobody":'))
    recording = _read(tree)
    assert {hand.side for hand in recording.hands} == {"left"}
    assert "the right hand is never tracked" in recording.messages


def test_masks_are_read_for_the_rgb_stream(readings, folder) -> None:
    (times, good), _ = read_mask(folder / "masks" / "mask_qa_pass.csv")
    assert np.array_equal(times, readings.masks["qa_pass"][0])
    assert good.all()
    set_cell("masks/mask_qa_pass.csv", 2, 2, "False")(folder)
    set_cell("masks/mask_qa_pass.csv", 6, 2, "False")(folder)  # of a SLAM camera
    assert read_mask(folder / "masks" / "mask_qa_pass.csv")[0][1].tolist().count(False) == 1


def test_meshes_are_an_option(readings, folder, tree) -> None:
    reader = reader_for("hot3d", {"meshes": "true"})
    recording = reader.read(reader.find(tree)[0])
    track, mesh = recording.objects[0], readings.objects[0].mesh
    assert mesh is not None
    assert track.surface is not None
    np.testing.assert_array_equal(track.surface[0], mesh[0])
    np.testing.assert_array_equal(track.surface[1], mesh[1])
    assert all(track.surface is None for track in _read(tree).objects)


def test_a_synthetic_tree_keeps_its_splits_where_the_folder_above_is_given(readings, tree) -> None:
    mark = {"generator": "x", "version": 1, "seed": 0, "preset": "hot3d", "world": "default"}
    for split in ("validation", "test"):
        (tree / "synthetic.json").write_text(json.dumps({**mark, "split": {readings.recording_id: split}}))
        assert [source.split for source in native_sources("hot3d", tree, BuildOptions())] == [split]
        assert [source.split for source in native_sources("hot3d", tree.parent, BuildOptions())] == [split]


def test_real_and_invented_recordings_do_not_mix(readings, tree) -> None:
    (tree.parent / "invented").mkdir()
    shutil.copytree(tree / readings.recording_id, tree.parent / "invented" / "other")
    mark = {"generator": "x", "version": 1, "seed": 0, "preset": "hot3d", "world": "default", "split": {}}
    (tree.parent / "invented" / "synthetic.json").write_text(json.dumps(mark))
    with pytest.raises(InputFileError, match="hot3d and synthetic-hot3d together"):
        native_sources("hot3d", tree.parent, BuildOptions())


def test_changed_models_change_the_digest_of_the_inputs(readings, tree) -> None:
    """The files that reading depends on are those that are listed."""
    (found,) = READER.find(tree)
    listed = {file.path for file in found.files}
    for path in sorted(tree.rglob("*")):
        if path.is_file() and path.suffix in (".csv", ".jsonl", ".glb", ".json") and "mask_" not in path.name:
            assert path in listed, path
    spare = tree / "assets" / "123.glb"
    shutil.copy(tree / "assets" / f"{readings.objects[0].object_id}.glb", spare)
    assert spare not in {file.path for file in READER.find(tree)[0].files}, "no object of this recording"
