"""Tables: iterated, looked up, as frames, also without a sequence; the story of an event."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import prbench
from prbench.sequences import SequenceTable
from prbench.sequences.schema import EVENTS, RECORDINGS, SEQUENCES
from tests import fakes


def test_a_table_opens_by_text_and_by_path(table, synthetic_folder, monkeypatch):
    assert prbench.open_table(str(table.folder)).folder == prbench.open_table(table.folder).folder
    monkeypatch.setenv("HOME", str(synthetic_folder.parent))
    assert len(prbench.open_table("~/synthetic")) == len(prbench.open_table(synthetic_folder))


def test_iteration_yields_every_row_once_and_in_order(table):
    found = list(table)
    assert len(found) == len(table) == 48
    assert tuple(sequence.sequence_id for sequence in found) == table.sequence_ids()
    assert [one.sequence_id for one in table.sequences(split="test")] == list(table.sequence_ids(split="test"))
    assert {one.split for one in table.sequences(split="test")} == {"test"}


def test_iteration_holds_a_few_rows_at_a_time(table, monkeypatch):
    sizes = []
    chunks = SequenceTable.chunks

    def _counted(self, **options):
        for chunk in chunks(self, **options):
            sizes.append(len(chunk))
            yield chunk

    monkeypatch.setattr(SequenceTable, "chunks", lambda self, **options: _counted(self, **options, rows=10))
    iterator = iter(table)
    first = next(iterator)
    assert sizes == [10]
    assert len(list(iterator)) == 47
    assert first.joints.base is None, "a kept sequence must not keep the rows that were read with it"


def test_a_sequence_of_an_iteration_that_was_given_up_has_all_its_values(table):
    iterator = iter(table)
    first = next(iterator)
    iterator.close()
    assert first.joints.base is None
    assert first.text == table[0].text
    np.testing.assert_array_equal(first.next_joints, table[0].next_joints)


def test_values_are_those_of_the_file(table):
    rows = SequenceTable.open(table.folder)
    chunk = next(rows.chunks(rows=256))
    for number, sequence in enumerate(table):
        begin, end = chunk.offsets[number : number + 2]
        np.testing.assert_array_equal(sequence.joints, chunk.joints[begin:end])
        np.testing.assert_array_equal(sequence.previous_joints, chunk.poses("previous_joints")[number])
        np.testing.assert_array_equal(sequence.gaze.direction, chunk.frames("gaze_direction")[begin:end])
        np.testing.assert_array_equal(sequence.goal.location, chunk.vectors("goal_location")[number])
        np.testing.assert_array_equal(sequence.goal.box_world_max, chunk.vectors("goal_box_world_max")[number])
        assert sequence.prime_after == pytest.approx(2.0)
        assert sequence.times[-1] == pytest.approx((sequence.n_frames - 1) / 20)
        assert sequence.n_frames == len(sequence.joints) == len(sequence.times)
        assert sequence.hand in ("left", "right", None)
    assert {sequence.extra.get("note") for sequence in table} == {"made up", None}
    assert {sequence.head is None for sequence in table} == {True, False}


def test_the_goal_is_the_centre_of_its_box(synthetic):
    for sequence in synthetic:
        np.testing.assert_allclose(sequence.goal.box_corners.mean(axis=0), sequence.goal.location, atol=1e-6)


def test_arrays_and_fields_are_frozen(table):
    sequence = table[0]
    groups = [sequence, sequence.goal, sequence.gaze, *([sequence.head] if sequence.head else [])]
    arrays = [
        value
        for group in groups
        for field in dataclasses.fields(group)
        if isinstance(value := getattr(group, field.name), np.ndarray)
    ]
    assert len(arrays) >= 11
    assert not any(array.flags.writeable for array in arrays)
    with pytest.raises(dataclasses.FrozenInstanceError):
        sequence.fps = 30.0


def test_a_sequence_is_found_by_id_part_and_number(table):
    ids = table.sequence_ids()
    assert table.sequence(ids[3]).sequence_id == table[3].sequence_id == table[ids[3]].sequence_id == ids[3]
    assert table[-1].sequence_id == ids[-1]
    assert [sequence.sequence_id for sequence in table[2:9:3]] == list(ids[2:9:3])
    assert [event.event_id for event in table.events[-2:]] == table.events.to_pandas().event_id.tolist()[-2:]
    assert [one.recording_id for one in table.recordings[:2]] == table.recordings.to_pandas().recording_id.tolist()[:2]
    assert table[100:] == table.events[100:] == []
    part = ids[5].split("/", 1)[1]
    assert table.sequence(part).sequence_id == ids[5]
    assert ids[0] in table
    assert "no such id" not in table


@pytest.mark.parametrize(
    ("wanted", "message"),
    [("obj", "fits 48 sequences of synthetic-adt; give a longer part"), ("nothing-like-it", "no sequence 'nothing")],
)
def test_unclear_ids_are_refused_as_on_the_command_line(table, wanted, message):
    with pytest.raises(prbench.PrbenchError, match=message):
        table.sequence(wanted)


def test_wrong_numbers_and_splits_are_refused(table):
    with pytest.raises(IndexError, match="expected a number below 48, found 48"):
        table[48]
    with pytest.raises(prbench.PrbenchError, match="unknown split 'tst'; the splits are: train, validation, test"):
        table.sequence_ids(split="tst")
    with pytest.raises(prbench.PrbenchError, match="unknown split 'tst'"):
        table.sequences(split="tst")
    with pytest.raises(prbench.PrbenchError, match="limit: expected a whole number of at least 1, found '0'"):
        table.sequence_ids(limit=0)


def test_limit_means_the_sequences_of_a_run(table, runs):
    assert set(table.sequence_ids(split="test", limit=6)) == set(runs[0].to_pandas().sequence_id)
    chosen = [sequence.sequence_id for sequence in table.sequences(split="test", limit=6)]
    assert chosen == list(table.sequence_ids(split="test", limit=6))


def test_a_row_is_found_in_a_later_part_and_row_group(tmp_path, table):
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = pq.read_table(table.folder / "sequences.parquet")
    (tmp_path / "sequences").mkdir()
    pq.write_table(rows.slice(0, 20), tmp_path / "sequences" / "part-00000.parquet", row_group_size=7)
    pq.write_table(rows.slice(20), tmp_path / "sequences" / "part-00001.parquet", row_group_size=11)
    parts = SequenceTable(tmp_path, table.info)
    assert parts.sequence_ids() == list(table.sequence_ids())
    for number in (0, 6, 7, 19, 20, 31, 47):
        found = parts.row(table.sequence_ids()[number])
        expected = pa.Table.from_batches([found.batch])
        assert expected.equals(rows.slice(number, 1), check_metadata=False)


def test_frames_have_the_columns_of_the_tables(table, empty):
    large = {"joints", "gaze_origin", "gaze_direction", "gaze_valid", "head_position", "head_rotation",
             "previous_joints", "next_joints"}  # fmt: skip
    for each in (table, empty):
        assert set(each.to_pandas()) == set(SEQUENCES.names) - large - {"extra"}
        assert set(each.to_pandas(arrays=True)) == set(SEQUENCES.names) - {"extra"}
        assert list(each.events.to_pandas()) == EVENTS.names
        assert list(each.recordings.to_pandas()) == RECORDINGS.names
    frame = table.to_pandas(arrays=True)
    assert isinstance(frame, pd.DataFrame)
    for row, sequence in zip(frame.itertuples(), table, strict=True):
        assert row.sequence_id == sequence.sequence_id
        np.testing.assert_array_equal(row.joints, sequence.joints)
        assert (row.head_position is None) == (sequence.head is None)
    assert np.stack(list(frame.goal_location)).shape == (48, 3)


def test_a_table_without_a_sequence(empty):
    assert len(empty) == len(empty.to_pandas()) == len(empty.events) == len(empty.recordings) == 0
    assert list(empty) == list(empty.events) == list(empty.recordings) == []
    assert empty.sequence_ids() == ()
    assert "recordings were read" in empty._repr_html_()
    with pytest.raises(IndexError):
        empty[0]
    with pytest.raises(prbench.PrbenchError, match="no sequence 'x' among the 0"):
        empty.sequence("x")


def test_events_and_recordings_behave_as_lists(synthetic):
    events = synthetic.events
    frame = events.to_pandas()
    assert len(events) == len(frame) == synthetic.info.counts.events
    assert [event.event_id for event in events] == frame.event_id.tolist()
    assert events[-1].event_id == frame.event_id.iloc[-1]
    became = [event for event in events if event.outcome == "sequence"]
    assert sorted(event.sequence_id for event in became) == sorted(synthetic.sequence_ids())
    located = next(event for event in events if event.location is not None)
    assert located.location.shape == (3,)
    assert not located.location.flags.writeable
    with pytest.raises(IndexError):
        events[len(events)]
    recordings = synthetic.recordings
    assert [recording.recording_id for recording in recordings] == recordings.to_pandas().recording_id.tolist()
    assert sum(recording.outcomes["sequence"] for recording in recordings) == len(synthetic)
    assert {recording.status for recording in recordings} == {"read"}


def test_one_row_a_frame(table):
    for sequence in (table[0], next(one for one in table if one.head is None)):
        frame = sequence.to_pandas()
        assert len(frame) == sequence.n_frames
        np.testing.assert_array_equal(frame.left_wrist_y, sequence.joints[:, prbench.Joint.LEFT_WRIST, 1])
        np.testing.assert_array_equal(frame.gaze_direction_z, sequence.gaze.direction[:, 2])
        assert ("head_rotation_w" in frame) == (sequence.head is not None)
        assert frame.time.iloc[-1] == pytest.approx(sequence.event_time - sequence.start_time)


def test_the_story_of_an_event(synthetic, tmp_path):
    frame = synthetic.events.to_pandas()
    story = synthetic.explain(frame.event_id[frame.outcome == "sequence"].iloc[0])
    assert story.outcome == "sequence"
    assert set(story.stages.values()) == {"passed"}
    assert str(story) == story.text
    assert "first look at" in story.text
    assert story.save(str(tmp_path / "story.png")) == tmp_path / "story.png"
    assert (tmp_path / "story.png").read_bytes() == story.picture.png
    shown = story._repr_html_()
    assert "<pre>" in shown
    assert "data:image/png;base64," in shown
    dropped = synthetic.explain(frame.event_id[frame.outcome != "sequence"].iloc[0])
    assert "stopped here" in dropped.stages.values()
    with pytest.raises(prbench.PrbenchError, match="no event 'nothing'"):
        synthetic.explain("nothing")
    with pytest.raises(prbench.PrbenchError, match="found an empty text"):
        synthetic.explain("")


def test_objects_describe_themselves(synthetic, table):
    assert f"{len(synthetic)} sequences" in repr(synthetic)
    assert synthetic[0].sequence_id in repr(synthetic[0])
    for shown in (synthetic, synthetic[0], synthetic.events, synthetic.recordings, table):
        text = shown._repr_html_()
        assert text.count("<table") == 1
        assert len(text) < 60_000
        assert len(repr(shown)) < 400
    for part in (table[0].goal, table[0].gaze, table[1].head, table.events[0]):
        assert len(repr(part)) < 200


def test_names_of_others_are_only_text_in_a_notebook(tmp_path, monkeypatch):
    made = fakes.fake_sequence

    def _hostile(index, **options):
        return dataclasses.replace(made(index, **options), object_name="<img src=x onerror=alert(1)>")

    monkeypatch.setattr(fakes, "fake_sequence", _hostile)
    fakes.fake_dataset(tmp_path / "table", 3)
    hostile = prbench.open_table(tmp_path / "table")
    for shown in (hostile, hostile[0], hostile.events, hostile.explain(hostile.events[0].event_id)):
        assert "<img src=x" not in shown._repr_html_()


@pytest.mark.parametrize("missing", ["nowhere", "file"])
def test_what_is_no_table_is_refused_as_on_the_command_line(tmp_path, missing):
    (tmp_path / "file").write_text("x")
    with pytest.raises(prbench.PrbenchError, match="expected a built dataset"):
        prbench.open_table(tmp_path / missing)


def test_the_embedded_tables_are_built_once(monkeypatch, tmp_path):
    from prbench.harness import first_run

    built = []

    def _build(preset, *, recordings, seed, out, engine, progress):
        built.append(out)
        fakes.fake_dataset(Path(out), 12, dataset=f"synthetic-{preset}")

    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path))
    monkeypatch.setattr("prbench.harness.synthetic_table.build_synthetic_table", _build)
    first = prbench.embedded_tables()
    folders = tuple(table.folder for table in prbench.embedded_tables())
    assert folders == tuple(table.folder for table in first) == first_run.default_table_folders()
    assert tuple(built) == folders
    assert [table.dataset for table in first] == [f"synthetic-{layout}" for layout in first_run.LAYOUTS]
    assert len(first[0]) == 12
