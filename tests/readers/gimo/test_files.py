"""GIMO segments: what is written comes back, and what is damaged is told."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from prbench.curation import build_dataset
from prbench.curation.job import native_sources
from prbench.curation.options import BuildOptions
from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint, transform_points
from prbench.protocol.manifests import load_manifest
from prbench.readers import reader_for
from prbench.readers.gimo import files as segments
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.synthetic import write_events
from prbench.readers.gimo.to_recording import recording_from_gimo
from tests.comparing import differences
from tests.readers import gimo_sample as sample


@pytest.fixture
def root(tmp_path):
    return sample.write_root(tmp_path / "GIMO", sample.readings())


def only(root, **options: str):
    reader = reader_for("gimo", options)
    (found,) = reader.find(root)
    return reader, found


@pytest.mark.unchecked_shapes  # the check itself would look into the list
def test_only_recordings_that_are_taken_are_listed(root, monkeypatch) -> None:
    other = sample.readings(sequence="2022-01-23-090000")
    sample.write_root(root, other, table=[sample.readings().segment, other.segment])
    listed = []
    names_of = segments.names_of
    monkeypatch.setattr(segments, "names_of", lambda folder: listed.append(folder) or names_of(folder))
    (source,) = native_sources("gimo", root, BuildOptions(limit=1))
    assert listed == []
    assert sum(file.role.startswith("pose:") for file in source.found.files) == sample.N_FRAMES
    assert {folder.parent.name for folder in listed} == {sample.readings().segment.sequence}


def test_the_files_of_a_recording_travel_to_another_process(root) -> None:
    _, found = only(root)
    there = pickle.loads(pickle.dumps(found))
    assert there == found
    assert len(there.files) == 4 + 3 * sample.N_FRAMES + 1


def test_files_and_memory_give_the_same_recording_bit_for_bit(root) -> None:
    reader, found = only(root)
    assert found.recording_id == "room1_2022-01-23-080759_100-144"
    assert (found.split, found.skip_reason) == ("train", None)
    assert list(differences(reader.read(found), sample.recording(sample.readings()))) == []


def test_the_body_is_where_scale_and_both_transforms_put_it(root) -> None:
    """x_c = Nn T x with the translations of both divided by the scale, written out by hand."""
    readings = sample.readings()
    reader, found = only(root)
    recording = reader.read(found)
    local = sample.STANDING - sample.STANDING[0] + sample.path_of_pelvis(np.arange(sample.N_FRAMES) / 30)[:, None]
    first, second = readings.transform.scene_from_body, readings.transform.room_from_scene
    in_scene = local @ first[:3, :3].T + first[:3, 3] / 1.25
    expected = in_scene @ second[:3, :3].T + second[:3, 3] / 1.25
    np.testing.assert_allclose(recording.body.joints, expected, atol=2e-6)
    gaze = (readings.gaze.points / 1.25) @ second[:3, :3].T + second[:3, 3] / 1.25
    toward = gaze - expected[:, Joint.HEAD]
    np.testing.assert_allclose(
        recording.gaze.direction, toward / np.linalg.norm(toward, axis=1, keepdims=True), atol=1e-5
    )
    np.testing.assert_allclose(transform_points(recording.world_from_source, readings.gaze.points), gaze, atol=1e-12)


def test_the_target_is_the_wrist_on_the_event_frame(root) -> None:
    reader, found = only(root)
    recording = reader.read(found)
    (event,) = recording.annotated_events
    assert (event.action, event.hand, event.event_time) == ("pick", "right", pytest.approx(139 / 30))
    np.testing.assert_array_equal(event.location, recording.body.joints[39, Joint.RIGHT_WRIST])
    np.testing.assert_array_equal(event.box_min, event.location)


def test_an_unnamed_hand_is_the_one_that_moves_more(root) -> None:
    readings = sample.readings()
    joints = np.tile(sample.STANDING, (sample.N_FRAMES, 1, 1))
    joints[30:40, Joint.LEFT_WRIST, 0] += np.linspace(0, 0.3, 10)
    joints[:20, Joint.RIGHT_WRIST, 0] += np.linspace(0, 3.0, 20)  # longer ago than half a second
    event = gimo.EventFrame(readings.segment.start_frame + 39)
    moved = replace(readings, body=gimo.LocalJoints(readings.segment.frames, joints), events=(event,))
    recording = sample.recording(moved)
    assert recording.annotated_events[0].hand == "left"
    assert "hand of frame 139 not annotated: the left one moves more before it" in recording.messages


@pytest.mark.parametrize(("missing", "invalid"), [(3, 0), (4, 4)])
def test_three_missing_frames_are_filled_and_four_are_a_gap(root, missing, invalid) -> None:
    for frame in range(120, 120 + missing):
        (root / "room1" / "2022-01-23-080759" / "smplx_local" / f"{frame}.pkl").unlink()
    reader, found = only(root)
    recording = reader.read(found)
    assert int((~recording.body.valid).sum()) == invalid
    assert f"{missing} of 45 frames have no pose, {invalid} in gaps too long to fill" in recording.messages
    true = sample.recording(sample.readings())
    if not invalid:
        np.testing.assert_allclose(recording.body.joints, true.body.joints, atol=0.01)


@pytest.mark.parametrize(("lost", "valid"), [(6, True), (7, False)])
def test_gaze_is_interpolated_up_to_a_quarter_second(lost, valid) -> None:
    readings = sample.readings()
    kept = np.delete(np.arange(sample.N_FRAMES), range(10, 10 + lost))
    gaze = gimo.GazePoints(readings.gaze.frames[kept], readings.gaze.points[kept])
    recording = sample.recording(replace(readings, gaze=gaze))
    assert recording.gaze.valid[10 : 10 + lost].all() == valid
    assert recording.gaze.valid[kept].all()
    if valid:
        full = sample.recording(readings)
        np.testing.assert_allclose(recording.gaze.direction, full.gaze.direction, atol=1e-9)


def test_splits_are_official_and_2_is_a_choice(tmp_path) -> None:
    segments = [sample.readings(), sample.readings(sequence="B"), sample.readings(sequence="C")]
    segments = [replace(s, segment=replace(s.segment, training=t)) for s, t in zip(segments, (1, 0, 2), strict=True)]
    root = sample.write_root(tmp_path, *segments)
    assert [found.split for found in reader_for("gimo").find(root)] == ["train", "test", "train"]
    reasons = [found.skip_reason for found in reader_for("gimo", {"training_2": "drop"}).find(root)]
    assert [reason is not None for reason in reasons] == [False, False, True]


def test_segments_of_one_recording_belong_together(tmp_path) -> None:
    first = sample.readings()
    later = replace(first.segment, start_frame=120, end_frame=140)
    root = sample.write_root(tmp_path, first, table=[first.segment, later])
    write_events(root / gimo.EVENTS_FILE, [(s, gimo.EventFrame(130, "left")) for s in (first.segment, later)])
    reader = reader_for("gimo")
    recordings = [reader.read(found) for found in reader.find(root)]
    assert {recording.split_group for recording in recordings} == {"room1_2022-01-23-080759"}
    assert "shares frames with the segment room1_2022-01-23-080759_120-140" in recordings[0].messages


def test_a_build_names_what_is_missing_and_goes_on(tmp_path) -> None:
    first = sample.readings()
    absent = [replace(first.segment, sequence=name) for name in ("2022-02-02-000000", "2022-02-03-000000")]
    root = sample.write_root(tmp_path / "GIMO", first, table=[first.segment, *absent, absent[0]])
    report = build_dataset("gimo", root, tmp_path / "table")
    assert [record.status for record in report.records] == ["read", "skipped", "skipped"]
    assert all("its folder is missing; unpack or download it" in record.message for record in report.records[1:])
    assert (report.info.counts.recordings_found, report.info.counts.recordings_failed) == (3, 0)


def test_a_segment_without_event_is_skipped_and_options_and_terms_stand_in_the_table(tmp_path) -> None:
    root = sample.write_root(tmp_path / "GIMO", replace(sample.readings(), events=()))
    options = BuildOptions(reader=(("hints", "false"), ("training_2", "drop")))
    report = build_dataset("gimo", root, tmp_path / "table", options=options)
    assert (report.records[0].status, report.info.counts.recordings_skipped) == ("skipped", 1)
    assert "no event is annotated for it" in report.records[0].message
    assert {"false", "drop"} <= set(report.info.options.values())
    assert report.info.redistribution == "none", "nothing of GIMO may be passed on"


def test_the_pose_source_tells_the_route() -> None:
    readings = sample.readings()
    manifest = load_manifest("gimo")
    assert recording_from_gimo(readings, manifest, dataset="gimo").pose_source == "gimo-bvh"
    joints = np.tile(sample.STANDING, (sample.N_FRAMES, 1, 1))
    body = gimo.LocalJoints(readings.segment.frames, joints)
    assert recording_from_gimo(replace(readings, body=body), manifest, dataset="gimo").pose_source == "gimo-smplx"


def test_a_table_of_events_that_is_not_there_is_named(root) -> None:
    with pytest.raises(InputFileError, match="expected the table of events that the option names"):
        reader_for("gimo", {"events": str(root / "mine.csv")}).find(root)


def test_nothing_of_gimo_may_be_passed_on(root, tmp_path) -> None:
    assert load_manifest("gimo").redistribution == "none"
    assert build_dataset("gimo", root, tmp_path / "table").info.redistribution == "none"
