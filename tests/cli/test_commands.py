"""The command line as a user meets it: help with examples, exit codes, one message for one mistake."""

from __future__ import annotations

import pytest

from prbench.cli import main
from tests.fakes import fake_dataset

COMMANDS = [
    ["run"],
    ["build-dataset"],
    ["explain"],
    ["synthesize"],
    ["score"],
    ["export-conditions"],
    ["leaderboard"],
    ["leaderboard", "export"],
    ["leaderboard", "compare"],
    ["import-release"],
    ["export-release"],
    ["adapters"],
    ["adapters", "list"],
]


@pytest.fixture
def data(tmp_path):
    return fake_dataset(tmp_path / "table", 24).folder


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert "example:\n  prbench " in text


def test_nothing_asked_shows_help_and_fails(capsys):
    assert main([]) == 2
    assert "commands:" in capsys.readouterr().out


def test_a_run_prints_scores_with_intervals_and_says_synthetic(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    out = tmp_path / "run"
    assert main(["run", "--method", "static", "--data", str(data), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "synthetic" in text
    assert "Prime Success" in text
    assert "95 % interval" in text
    assert str(out) in text
    assert "stands still" in text, "Foot Skating of a motionless method is no number"
    assert (out / "summary.json").is_file()


def test_several_datasets_may_follow_one_option_or_repeat_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    one = fake_dataset(tmp_path / "one", 12, dataset="synthetic-one").folder
    two = fake_dataset(tmp_path / "two", 12, dataset="synthetic-two").folder
    for number, arguments in enumerate((["--data", str(one), str(two)], ["--data", str(one), "--data", str(two)])):
        out = tmp_path / f"run{number}"
        assert main(["run", "--method", "ground-truth", *arguments, "--out", str(out)]) == 0
        assert sorted(folder.name for folder in out.iterdir() if folder.is_dir()) == ["synthetic-one", "synthetic-two"]


def test_the_whole_way_from_run_to_leaderboard_and_score(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    run = tmp_path / "runs" / "truth"
    assert main(["run", "--method", "ground-truth", "--data", str(data), "--out", str(run)]) == 0
    assert main(["score", str(run), "--data", str(data), "--out", str(tmp_path / "scored")]) == 0
    assert (tmp_path / "scored" / "scores.parquet").read_bytes() == (run / "scores.parquet").read_bytes()
    capsys.readouterr()
    assert main(["leaderboard", "export", str(tmp_path / "runs"), "--format", "md"]) == 0
    printed = capsys.readouterr().out
    assert "| control | ground-truth |" in printed
    board = tmp_path / "board.csv"
    assert main(["leaderboard", "export", str(run), "--format", "csv", "--out", str(board)]) == 0
    assert board.read_text().startswith("table,dataset,condition,method")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["run", "--method", "statik", "--data", "{data}"], 5, "Did you mean 'static'?"),
        (["run", "--method", "static", "--condition", "goal-loc", "--data", "{data}"], 5, "Choose one of: none."),
        (["run", "--method", "static", "--option", "speed=3", "--data", "{data}"], 5, "unknown option 'speed'"),
        (["run", "--method", "static", "--data", "{tmp}/nowhere"], 4, "expected a built dataset"),
        (["score", "{tmp}/missing.parquet", "--data", "{data}"], 6, "missing.parquet"),
        (["leaderboard", "export", "{tmp}"], 7, "found none"),
        (["build-dataset", "adt", "--root", "{tmp}/nowhere", "--out", "{tmp}/x"], 3, "found no such folder"),
        (["build-dataset", "adt", "--root", "{tmp}"], 2, "--out DIR is needed"),
        (["build-dataset", "atd", "--root", "{tmp}", "--out", "{tmp}/x"], 2, "adt"),
        (["build-dataset", "adt", "--root", "{tmp}", "--out", "{tmp}/x", "--occlusion", "mark"], 2, "adt has none"),
        (["synthesize", "adt"], 2, "--out DIR is needed"),
        (["synthesize"], 2, "name a layout"),
        (["synthesize", "adt", "--size", "large", "--out", "{tmp}/x"], 2, "large"),
        (["synthesize", "unheard-of", "--out", "{tmp}/x"], 2, "adt"),
    ],
)
def test_a_mistake_gives_one_message_and_its_exit_code(arguments, code, message, data, tmp_path, capsys):
    filled = [part.format(data=data, tmp=tmp_path) for part in arguments]
    assert main(filled) == code
    errors = capsys.readouterr().err
    assert message in errors
    assert "Traceback" not in errors
    assert len(errors.strip().splitlines()) == 1
    assert not (tmp_path / "x").exists(), "nothing half-written stays"


def test_wrong_arguments_are_answered_by_the_parser(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["run", "--method", "static", "--limit", "0"])
    assert stop.value.code == 2
    assert "expected a whole number of at least 1, found '0'" in capsys.readouterr().err


def test_histograms_are_drawn_beside_the_studys_numbers(tmp_path):
    picture = tmp_path / "h.png"
    assert main(["synthesize", "adt", "--histograms", str(picture), "--count", "1"]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["h.png"], "a picture alone writes no recordings"
