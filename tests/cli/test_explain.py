"""``prbench explain`` as a program reads it."""

from __future__ import annotations

from prbench.sequences import SequenceTable
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


def test_the_story_of_an_event_is_reported_as_json(tmp_path, capsys):
    folder = fake_dataset(tmp_path / "table", 4).folder
    event = SequenceTable.open(folder).events().to_pylist()[0]
    picture = tmp_path / "story.png"
    words = ["explain", event["event_id"], "--data", str(folder), "--draw", str(picture)]
    report = reported(words, capsys)
    assert report.event_id == event["event_id"]
    assert report.sequence_id == event["sequence_id"]
    assert report.outcome == "sequence"
    assert [stage.name for stage in report.stages] == [
        "in hand", "location", "priming", "clipping", "body", "filters",
    ]  # fmt: skip
    assert {stage.verdict for stage in report.stages} == {"passed"}
    assert picture.is_file()


def test_an_event_that_is_not_there_is_an_error_in_the_document(tmp_path, capsys):
    folder = fake_dataset(tmp_path / "table", 4).folder
    refused(["explain", "teapot", "--data", str(folder)], capsys, code=2, message="no event 'teapot' among the 4")
