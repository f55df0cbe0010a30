"""``prbench view``, ``explain`` and ``diff``, and the motions that ``prbench run --sequence`` shows."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from prbench.cli import main
from prbench.harness.run_folder import Predictions, RunRecord
from prbench.sequences import SequenceTable
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset

PNG = b"\x89PNG\r\n\x1a\n"
RUN = ["run", "--method", "scripted", "--condition", "goal-loc", "--data"]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("data") / "table", 24).folder


@pytest.fixture(scope="module")
def run(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "scripted"
    assert main([*RUN, str(data), "--out", str(out)]) == 0
    return out


def test_a_run_becomes_a_picture(run, data, tmp_path, capsys):
    out = tmp_path / "view.png"
    assert main(["view", str(run), "--data", str(data), "--limit", "1", "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert out.read_bytes().startswith(PNG)
    for line in ("ground truth: Prime Success", "scripted, goal-loc: Prime Success", f"view: {out}"):
        assert line in said.out
    assert "drawing view.png: 1/1" in said.err
    assert main(["view", "--data", str(data), "--sequence", "/obj1/", "--out", str(tmp_path / "table.png")]) == 0


def test_without_a_file_a_page_in_the_run_folder_shows_all_sequences_the_worst_first(run, data, capsys):
    report = reported(["view", str(run), "--data", str(data)], capsys)
    assert report.out == run / "motions.html"
    assert report.left_out == 0
    scored = reported(["score", str(run), "--data", str(data)], capsys)[0]
    assert [row.sequence_id for row in scored.sequences] == report.sequences
    assert [f"{run.as_uri()}/{row.motion}" for row in scored.sequences] == report.links
    assert set(report.sequences) == set(Predictions.open(run / "synthetic-adt/predictions").ids)
    assert main(["view", str(run), "--data", str(data)]) == 0
    said = capsys.readouterr().out
    assert report.links[0] in said
    assert f"view: {run / 'motions.html'}" in said


def test_where_the_run_folder_cannot_be_written_the_page_goes_into_the_present_one(
    run, data, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    # Root, as whom tests may run, can write any folder.
    monkeypatch.setattr("prbench.viewing.view.os", SimpleNamespace(access=lambda *_: False, W_OK=2))
    assert reported(["view", str(run), "--data", str(data), "--limit", "1"], capsys).out == Path("motions.html")
    assert (tmp_path / "motions.html").is_file()
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "motions.html").unlink()
    assert reported(["view", "--data", str(data), "--limit", "2"], capsys).out == Path("motions.html")


def test_a_page_holds_what_fits_and_says_what_is_left_out(run, data, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("prbench.viewing.view.LARGEST_PAGE", 200_000)
    out = tmp_path / "page.html"
    report = reported(["view", str(run), "--data", str(data), "--out", str(out)], capsys)
    assert 0 < len(report.sequences) < len(report.sequences) + report.left_out
    assert out.read_text(encoding="utf-8").count('type="application/json" class="sequence"') == len(report.sequences)
    assert main(["view", str(run), "--data", str(data), "--out", str(out), "--open"]) == 0
    said = capsys.readouterr().err
    assert f"no room for {report.left_out} more sequences" in said
    assert "no browser was opened" in said


def test_what_a_view_shows_is_reported_as_json(run, data, tmp_path, capsys):
    out = tmp_path / "view.png"
    report = reported(["view", str(run), "--data", str(data), "--sequence", "/obj5/", "--out", str(out)], capsys)
    (sequence,) = report.sequences
    assert report.out == out
    assert "/obj5/" in sequence
    refused(["view", "--out", str(out)], capsys, code=2, message="nothing to view")


def test_mistakes_are_told_in_one_message(run, data, tmp_path, capsys):
    for words, code, message in (
        (["view", str(run), "--data", str(data), "--out", "a.gif"], 2, ".html, .png, .svg, .pdf or .mp4"),
        (["view", "--out", "a.png"], 2, "nothing to view"),
        (["view", str(data), "--out", "a.png"], 7, "expected a run folder"),
        (["view", str(run), "--data", str(data), "--sequence", "obj1/pikc", "--out", "a.png"], 2, "Near it:"),
        ([*RUN, str(data), "--sequence", "obj5/pikc"], 2, "Near it:"),
        ([*RUN, str(data), "--sequence", "/obj0/"], 2, "--split train"),
        ([*RUN, str(data), "--sequence", "/obj5/", "--limit", "2"], 2, "leave --limit out"),
        ([*RUN, str(data), "--out", str(tmp_path / "r"), "--view", "a.gif"], 2, ".html, .png, .svg, .pdf or .mp4"),
    ):
        assert main(words) == code
        assert message in capsys.readouterr().err
    assert not (tmp_path / "r").exists(), "a view that cannot be written stops before the run"


def test_a_single_sequence_is_run_recorded_scored_and_shown(data, tmp_path, capsys):
    out, picture = tmp_path / "one", tmp_path / "one.png"
    words = [*RUN, str(data), "--out", str(out)]
    assert main([*words, "--sequence", "/obj5/", "--view", str(picture)]) == 0
    said = capsys.readouterr().out
    record = RunRecord.read(out)
    (name,) = record.sequences
    assert "/obj5/" in name
    assert (record.tables[0].sequences, record.limit) == (1, None)
    for part in (name, "Reach Success", "yes", f"view: {picture}"):
        assert part in said
    assert picture.read_bytes().startswith(PNG)
    assert main([*words, "--sequence", "/obj9/"]) == 7
    assert "run.json, sequences" in capsys.readouterr().err
    assert main(["score", str(out), "--data", str(data)]) == 0


def test_the_single_sequence_gets_the_motion_that_the_whole_run_gives_it(run, data, tmp_path):
    out = tmp_path / "one"
    assert main([*RUN, str(data), "--out", str(out), "--sequence", "/obj5/", "--sequence", "/obj9/"]) == 0
    alone, whole = (Predictions.open(each / "synthetic-adt/predictions") for each in (out, run))
    assert len(alone.ids) == 2
    for name in alone.ids:
        assert (alone.motions([name], 0).values == whole.motions([name], 0).values).all()


def test_the_story_of_an_event_is_reported_as_json(data, tmp_path, capsys):
    event = SequenceTable.open(data).events().to_pylist()[0]
    picture = tmp_path / "story.png"
    report = reported(["explain", event["event_id"], "--data", str(data), "--draw", str(picture)], capsys)
    assert (report.event_id, report.sequence_id) == (event["event_id"], event["sequence_id"])
    assert report.outcome == "sequence"
    names = ["in hand", "location", "priming", "clipping", "body", "filters"]
    assert [(stage.name, stage.verdict) for stage in report.stages] == [(name, "passed") for name in names]
    assert picture.is_file()
    refused(["explain", "teapot", "--data", str(data)], capsys, code=2, message="no event 'teapot' among the 24")


def test_what_differs_between_builds_is_reported_and_ends_with_one(data, tmp_path, capsys):
    equal = ["diff", str(data), str(data)]
    report = reported(equal, capsys)
    assert (report.changes, report.unchanged_events) == ([], 24)
    other = str(fake_dataset(tmp_path / "other", 20).folder)
    assert reported(["diff", str(data), other], capsys, code=1).changes
    out = tmp_path / "report.json"
    assert main([*equal, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "unchanged: 24 events" in printed
    assert f"report: {out}" in printed
    assert json.loads(out.read_text())["report"]["changes"] == []
    refused(["diff", str(data), str(tmp_path / "gone")], capsys, code=4, message="gone")
