"""Proposed picks: what reaching looks like, and the table of proposals, from files to a build."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from prbench.cli.main import main
from prbench.curation import build_dataset
from prbench.curation.options import BuildOptions
from prbench.curation.propose_events import propose_pick, write_candidates
from prbench.errors import StorageError, UsageError
from prbench.geometry.skeleton import Joint
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.format import CANDIDATE_COLUMNS as COLUMNS
from prbench.recording import BodyStream, GazeStream, Recording
from tests.cli.reports import printed_document, refused, reported
from tests.curation.scenes import minimum_jerk
from tests.fakes import STANDING
from tests.readers import gimo_sample
from tests.readers import gimo_sample as sample


@pytest.fixture
def root(tmp_path):
    first = replace(sample.readings(), events=())
    first = replace(first, segment=replace(first.segment, hint=130))
    second = sample.readings(sequence="2022-02-02-000000")
    absent = replace(first.segment, sequence="2022-03-03-000000")
    return sample.write_root(tmp_path / "GIMO", first, second, table=[first.segment, second.segment, absent])


def rows_of(path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_segment_has_a_line_and_none_counts_before_it_is_confirmed(root, tmp_path, capsys) -> None:
    out = tmp_path / "candidates.csv"
    assert main(["build-dataset", "gimo", "--root", str(root), "--propose-events", str(out)]) == 3, (
        "one segment could not be read"
    )
    rows = rows_of(out)
    assert tuple(rows[0]) == COLUMNS
    assert [row["sequence_path"] for row in rows] == ["2022-01-23-080759", "2022-02-02-000000", "2022-03-03-000000"]
    assert {row["confirmed"] for row in rows} == {""}
    assert rows[0]["event_frame"] == "130"
    assert rows[0]["reason"].startswith("hint +0.00 s away")
    assert rows[2]["reason"].startswith("not read: ")
    assert "1 not read" in capsys.readouterr().out
    options = BuildOptions(reader=(("events", str(out)),))
    records = build_dataset("gimo", root, tmp_path / "before", options=options).records
    assert [record.status for record in records] == ["skipped"] * 3

    rows[0]["confirmed"] = "yes"
    with open(out, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    records = build_dataset("gimo", root, tmp_path / "after", options=options).records
    assert [record.status for record in records] == ["read", "skipped", "skipped"]
    assert sum(records[0].outcomes.values()) == 1


def test_proposals_are_reported_as_they_are_written(root, tmp_path, capsys) -> None:
    words = ["build-dataset", "gimo", "--root", str(root), "--propose-events"]
    report = reported([*words, str(tmp_path / "c.csv")], capsys, code=3)
    rows = rows_of(tmp_path / "c.csv")
    assert [{name: str(value) for name, value in each.items()} for each in report.proposed] == rows
    assert report.proposed[2]["hand"] == ""
    document = printed_document([*words, str(tmp_path / "d.csv")], capsys, code=3)
    (note,) = document.notes
    assert note.endswith(f": {rows[2]['reason']}")
    refused([*words, str(tmp_path / "c.csv")], capsys, code=8, message="never overwritten")


def test_annotations_are_never_overwritten(root, tmp_path) -> None:
    mine = tmp_path / gimo.EVENTS_FILE
    mine.write_text("my work")
    with pytest.raises(StorageError, match="annotations are never overwritten"):
        write_candidates("gimo", root, mine)
    assert mine.read_text() == "my work"


def test_datasets_with_events_of_their_own_need_none(root, tmp_path) -> None:
    with pytest.raises(UsageError, match="proposals are for: gimo"):
        write_candidates("adt", root, tmp_path / "a.csv")


REACH, FALSE_REACH = 4.0, 7.0
"""When the right wrist arrives at a shelf with gaze on it, and when it does so unseen, seconds."""
PLACE = STANDING[Joint.RIGHT_SHOULDER] + np.array([-0.05, 0.05, 0.5])


def scene(*, looks: bool = True, moves: bool = True) -> Recording:
    times = np.arange(300) / 30
    joints = np.tile(STANDING, (len(times), 1, 1))
    joints += 0.001 * np.sin(7 * times)[:, None, None]
    for arrival in (REACH, FALSE_REACH) if moves else ():
        share = minimum_jerk((times - arrival + 0.8) / 0.8) * (1 - minimum_jerk((times - arrival - 0.1) / 0.8))
        there = PLACE + (0.0 if arrival == REACH else np.array([0.0, -0.3, -0.2]))
        joints[:, Joint.RIGHT_WRIST] += share[:, None] * (there - STANDING[Joint.RIGHT_WRIST])
        elbow = (there + STANDING[Joint.RIGHT_SHOULDER]) / 2 - STANDING[Joint.RIGHT_ELBOW]
        joints[:, Joint.RIGHT_ELBOW] += share[:, None] * elbow
    head = joints[:, Joint.HEAD]
    target = np.where((np.abs(times - REACH) < 1.0)[:, None], PLACE, [2.0, 0.0, 0.5])
    apart = target - head
    valid = np.full(len(times), looks)
    base = gimo_sample.recording(gimo_sample.readings())
    return replace(
        base,
        body=BodyStream(times, joints, np.ones(len(times), dtype=bool)),
        gaze=GazeStream(times, head, apart / np.linalg.norm(apart, axis=1, keepdims=True), valid),
    )


def test_the_stop_of_a_stretched_arm_under_gaze_is_proposed() -> None:
    found = propose_pick(scene())
    assert abs(found.time - REACH) < 0.15
    assert found.hand == "right"
    assert found.confidence > 0.8
    assert "right wrist slows from" in found.reason
    assert "gaze 0 cm from the wrist" in found.reason


def test_gaze_makes_the_difference() -> None:
    with_gaze, without = propose_pick(scene()), propose_pick(scene(looks=False))
    assert without.confidence < with_gaze.confidence
    assert "no gaze" in without.reason


def test_a_hint_chooses_the_stop_beside_it() -> None:
    found = propose_pick(scene(), hint=FALSE_REACH + 0.2)
    assert abs(found.time - FALSE_REACH) < 0.15
    assert found.reason.startswith("hint -0.")


def test_a_hint_counts_even_where_nothing_stops() -> None:
    found = propose_pick(scene(moves=False), hint=5.0)
    assert found.time == 5.0
    assert found.confidence < 0.8


def test_who_only_stands_gets_no_proposal() -> None:
    assert propose_pick(scene(moves=False)) is None
    assert propose_pick(replace(scene(), body=None)) is None
