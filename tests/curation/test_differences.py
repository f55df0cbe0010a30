"""``prbench diff``: two builds of the same recordings, event by event."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from prbench.curation.differences import compare_builds
from prbench.errors import UsageError
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.sequence import Recording, event_batch, recording_batch, sequence_batch
from prbench.sequences.write import write_dataset
from tests.fakes import fake_event, fake_info, fake_sequence

ROWS = sorted((fake_sequence(index, recordings=2) for index in range(6)), key=lambda row: row.sequence_id)


def write(
    folder: Path, rows=ROWS, events=None, *, failed: str = "", recording: Mapping[str, Any] = {}, lacks: str = ""
) -> Path:
    events = [fake_event(row) for row in rows] if events is None else events
    names = sorted({row.recording_id for row in ROWS} - {lacks})
    records = [
        Recording(
            recording_id=name, participant_id="P", split="train", split_group=name, duration=9.0, outcomes={},
            status="failed" if name == failed else "read", message="gaze.csv is missing" if name == failed else "",
        )
        for name in names
    ]  # fmt: skip
    records[0] = dataclasses.replace(records[0], **recording)
    rows = list(rows)
    write_dataset(
        folder,
        fake_info(sequences=len(rows)),
        sequences=[sequence_batch(rows)],
        events=[event_batch(events)],
        recordings=[recording_batch(records)],
    )
    return folder


@pytest.fixture
def first(tmp_path) -> Path:
    return write(tmp_path / "first")


def changes_to(first: Path, rows, events=None, **options) -> list[tuple[str, str, str, str]]:
    second = write(first.with_name("second"), rows, events, **options)
    return [(c.kind, c.first, c.second, c.decided_by) for c in compare_builds(first, second).changes]


def test_a_build_does_not_differ_from_itself(first) -> None:
    difference = compare_builds(first, first)
    assert difference.equal
    assert (difference.unchanged_events, difference.unchanged_sequences) == (6, 6)
    assert difference.settings == ()


def test_a_lost_sequence_comes_with_the_stage_and_the_number_that_decided(first) -> None:
    lost = fake_event(ROWS[0], outcome="not_primed", stage="priming", value=0.09, threshold=0.05, sequence_id=None)
    found = changes_to(first, ROWS[1:], [lost, *map(fake_event, ROWS[1:])])
    assert found == [("lost", "sequence", "not_primed", "priming: 0.090 (threshold 0.05)")]
    second = first.with_name("second")
    assert [c.kind for c in compare_builds(second, first).changes] == ["gained"]


def test_an_event_that_moved_less_than_a_second_is_the_same_event(first) -> None:
    moved = dataclasses.replace(ROWS[0], event_time=ROWS[0].event_time + 0.25, sequence_id="other/id/body")
    rows = sorted((moved, *ROWS[1:]), key=lambda row: row.sequence_id)
    assert changes_to(first, rows) == [("moved", "sequence", "sequence", "event +0.250 s")]


def test_an_event_that_moved_farther_vanished_and_another_appeared(first) -> None:
    moved = dataclasses.replace(ROWS[0], event_time=ROWS[0].event_time + 1.5, sequence_id="other/id/body")
    rows = sorted((moved, *ROWS[1:]), key=lambda row: row.sequence_id)
    assert [change[0] for change in changes_to(first, rows)] == ["appeared", "vanished"]


def test_events_of_a_recording_that_failed_vanished_for_its_reason(first) -> None:
    gone = ROWS[0].recording_id
    rows = [row for row in ROWS if row.recording_id != gone]
    found = {(change[0], change[3]) for change in changes_to(first, rows, failed=gone)}
    assert found == {("vanished", "recording failed: gaze.csv is missing")}


@pytest.mark.parametrize("amount", [2e-5, 0.01])
def test_other_poses_under_the_same_name_are_seen(first, amount) -> None:
    joints = ROWS[0].joints.copy()
    joints[-1, 3] += amount
    changed = dataclasses.replace(ROWS[0], joints=joints)
    assert [change[0] for change in changes_to(first, [changed, *ROWS[1:]])] == ["values"]


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("goal_location", np.array([9.0, 1.0, 2.0])),
        ("hand", None),
        ("text", "other words"),
        ("body_movement", 7.5),
        ("extra", {"note": "another"}),
        ("prime_time_uncertainty", 0.5),
        ("gaze_valid", np.zeros(ROWS[0].n_frames, dtype=bool)),
        ("world_from_canonical", 2 * np.eye(4)),
    ],
)
def test_every_column_of_a_sequence_is_compared(first, column, value) -> None:
    events = [fake_event(row) for row in ROWS]
    changed = [dataclasses.replace(ROWS[0], **{column: value}), *ROWS[1:]]
    assert changes_to(first, changed, events) == [("values", "sequence", "sequence", column)]


@pytest.mark.parametrize(
    ("column", "value"),
    [("object_name", "Cup"), ("box_max", np.array([9.0, 9.0, 9.0])), ("threshold", 0.3), ("value", None)],
)
@pytest.mark.parametrize("outcome", ["sequence", "not_primed"])
def test_every_column_of_an_event_is_compared(tmp_path, column, value, outcome) -> None:
    event = fake_event(ROWS[0], outcome=outcome)
    first = write(tmp_path / "first", ROWS, [event, *map(fake_event, ROWS[1:])])
    events = [dataclasses.replace(event, **{column: value}), *map(fake_event, ROWS[1:])]
    assert changes_to(first, ROWS, events) == [("values", outcome, outcome, column)]


@pytest.mark.parametrize(("column", "value"), [("duration", 8.0), ("participant_id", "Q"), ("message", "hm")])
def test_every_column_of_a_recording_is_compared(first, column, value) -> None:
    second = write(first.with_name("second"), **{"recording": {column: value}})
    found = [(c.kind, c.event, c.decided_by) for c in compare_builds(first, second).changes]
    assert found == [("values", "", column)]


def test_a_recording_without_events_that_one_build_alone_has_is_seen(tmp_path) -> None:
    idle = ROWS[-1].recording_id
    rows = [row for row in ROWS if row.recording_id != idle]
    both, fewer = write(tmp_path / "both", rows), write(tmp_path / "fewer", rows, lacks=idle)
    (vanished,) = compare_builds(both, fewer).changes
    (appeared,) = compare_builds(fewer, both).changes
    assert (vanished.kind, vanished.recording_id, vanished.first, vanished.second) == ("vanished", idle, "read", "")
    assert (appeared.kind, appeared.recording_id, appeared.first, appeared.second) == ("appeared", idle, "", "read")


def test_a_sequence_that_no_event_names_is_seen(first) -> None:
    assert changes_to(first, ROWS[1:], [fake_event(row) for row in ROWS]) == [
        ("values", "sequence", "sequence", "no row in sequences in one of them")
    ]
    second = write(first.with_name("second"), ROWS[1:], [fake_event(row) for row in ROWS[1:]])
    third = write(first.with_name("third"), ROWS, [fake_event(row) for row in ROWS[1:]])
    changes = compare_builds(second, third).changes
    assert [(c.kind, c.decided_by) for c in changes] == [("appeared", "a sequence that no event names")]


def test_what_was_chosen_differently_is_listed(first) -> None:
    second = write(first.with_name("second"))
    info = DatasetInfo.read(second)
    info = msgspec.structs.replace(info, options={"ray_origin": "camera"}, protocol_digest="q")
    info.write(second)
    assert compare_builds(first, second).settings == (
        ("protocol_digest", "p", "q"),
        ("option ray_origin", "–", "camera"),
    )


def test_other_boxes_of_the_scene_and_another_title_are_seen(first, monkeypatch) -> None:
    second = write(first.with_name("second"))
    msgspec.structs.replace(DatasetInfo.read(second), title="Another").write(second)
    scenes = [pa.table({"x": [1.0]}), pa.table({"x": [2.0]})]
    monkeypatch.setattr(SequenceTable, "scenes", lambda _: scenes.pop())
    difference = compare_builds(first, second)
    assert [setting[0] for setting in difference.settings] == ["title"]
    assert [change.decided_by for change in difference.changes] == ["boxes of the scenes"]


def test_builds_of_different_datasets_are_not_compared(first) -> None:
    second = write(first.with_name("second"))
    msgspec.structs.replace(DatasetInfo.read(second), dataset="synthetic-gimo").write(second)
    with pytest.raises(UsageError, match="synthetic-gimo"):
        compare_builds(first, second)


def test_what_an_older_version_does_not_tell_is_no_difference(first) -> None:
    surer = [fake_event(row, event_confidence=0.5, prime_margin=0.02) for row in ROWS]
    second = write(first.with_name("second"), events=surer)
    assert {change.decided_by for change in compare_builds(first, second).changes} == {"prime_margin, event_confidence"}
    msgspec.structs.replace(DatasetInfo.read(first), schema_version=3).write(first)
    assert compare_builds(first, second).equal
