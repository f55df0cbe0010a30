"""``prbench view`` and ``prbench run --sequence`` as a user types them."""

from __future__ import annotations

import pytest

from prbench.cli import main
from prbench.harness.run_folder import RunRecord
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("data") / "table", 24).folder


@pytest.fixture(scope="module")
def run(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "scripted"
    words = ["run", "--method", "scripted", "--condition", "goal-loc", "--data", str(data), "--out", str(out)]
    assert main(words) == 0
    return out


def test_a_run_becomes_a_picture(run, data, tmp_path, capsys):
    out = tmp_path / "view.png"
    assert main(["view", str(run), "--data", str(data), "--limit", "1", "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert out.read_bytes().startswith(PNG)
    assert "ground truth: Prime Success" in said.out
    assert "scripted, goal-loc: Prime Success" in said.out
    assert f"view: {out}" in said.out
    assert "drawing view.png: 1/1" in said.err


def test_what_a_view_shows_is_reported_as_json(run, data, tmp_path, capsys):
    out = tmp_path / "view.png"
    words = ["view", str(run), "--data", str(data), "--sequence", "/obj5/", "--out", str(out)]
    report = reported(words, capsys)
    (sequence,) = report.sequences
    assert report.out == out
    assert "/obj5/" in sequence
    refused(["view", "--out", str(out)], capsys, code=2, message="nothing to view")


def test_a_table_becomes_a_picture(data, tmp_path):
    assert main(["view", "--data", str(data), "--sequence", "/obj1/", "--out", str(tmp_path / "a.png")]) == 0


def test_mistakes_are_told_in_one_message(run, data, tmp_path, capsys):
    for words, code, message in (
        (["view", str(run), "--data", str(data), "--out", "a.gif"], 2, ".png, .mp4 or .html"),
        (["view", "--out", "a.png"], 2, "nothing to view"),
        (["view", str(data), "--out", "a.png"], 7, "expected a run folder"),
        (["view", str(run), "--data", str(data), "--sequence", "obj1/pikc", "--out", "a.png"], 2, "Near it:"),
    ):
        assert main(words) == code
        assert message in capsys.readouterr().err


def test_a_single_sequence_is_run_recorded_scored_and_shown(data, tmp_path, capsys):
    out, picture = tmp_path / "one", tmp_path / "one.png"
    words = ["run", "--method", "scripted", "--condition", "goal-loc", "--data", str(data), "--out", str(out)]
    assert main([*words, "--sequence", "/obj5/", "--view", str(picture)]) == 0
    said = capsys.readouterr().out
    record = RunRecord.read(out)
    (name,) = record.sequences
    assert "/obj5/" in name
    assert record.tables[0].sequences == 1
    assert record.limit is None
    assert name in said
    assert "Reach Success" in said
    assert "yes" in said
    assert f"view: {picture}" in said
    assert picture.read_bytes().startswith(PNG)


def test_the_single_sequence_gets_the_motion_that_the_whole_run_gives_it(run, data, tmp_path):
    from prbench.harness.run_folder import Predictions

    out = tmp_path / "one"
    words = ["run", "--method", "scripted", "--condition", "goal-loc", "--data", str(data), "--out", str(out)]
    assert main([*words, "--sequence", "/obj5/", "--sequence", "/obj9/"]) == 0
    alone, whole = (
        Predictions.open(out / "synthetic-adt/predictions"),
        Predictions.open(run / "synthetic-adt/predictions"),
    )
    assert len(alone.ids) == 2
    for name in alone.ids:
        assert (alone.motions([name], 0).values == whole.motions([name], 0).values).all()


def test_a_run_of_single_sequences_is_no_other_run(data, tmp_path, capsys):
    out = tmp_path / "one"
    words = ["run", "--method", "scripted", "--condition", "goal-loc", "--data", str(data), "--out", str(out)]
    assert main([*words, "--sequence", "/obj5/"]) == 0
    assert main([*words, "--sequence", "/obj9/"]) == 7
    assert "run.json, sequences" in capsys.readouterr().err
    assert main(["score", str(out), "--data", str(data)]) == 0


def test_a_sequence_to_run_that_does_not_exist_or_is_elsewhere(data, capsys):
    words = ["run", "--method", "scripted", "--condition", "goal-loc", "--data", str(data)]
    assert main([*words, "--sequence", "obj5/pikc"]) == 2
    assert "Near it:" in capsys.readouterr().err
    assert main([*words, "--sequence", "/obj0/"]) == 2
    assert "--split train" in capsys.readouterr().err
    assert main([*words, "--sequence", "/obj5/", "--limit", "2"]) == 2
    assert "leave --limit out" in capsys.readouterr().err


def test_a_view_that_cannot_be_written_stops_before_the_run(data, tmp_path, capsys):
    words = [
        "run",
        "--method",
        "scripted",
        "--condition",
        "goal-loc",
        "--data",
        str(data),
        "--out",
        str(tmp_path / "r"),
    ]
    assert main([*words, "--view", "a.gif"]) == 2
    assert not (tmp_path / "r").exists()
    assert ".png, .mp4 or .html" in capsys.readouterr().err
