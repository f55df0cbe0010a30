"""One file for several runs, what a command line means as such a file, and a run that is repeated."""

from __future__ import annotations

import json

import msgspec
import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.errors import InputFileError, UsageError
from prbench.harness.first_run import earlier_run, same_scores
from prbench.harness.request import Experiment, read_experiment
from prbench.harness.run_folder import RunFolder
from tests.fakes import fake_dataset

FILE = """
data = ["{data}"]
seeds = [0, 1]
limit = 3
out = "{out}"

[[methods]]
name = "ground-truth"

[[methods]]
name = "scripted"
conditions = ["goal-loc", "none"]
control = "shuffled-goal"
"""


@pytest.fixture
def data(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    return fake_dataset(tmp_path / "table", 24).folder


def written(tmp_path, text: str):
    path = tmp_path / "experiment.toml"
    path.write_text(text)
    return path


def test_every_method_is_run_under_every_condition_with_every_seed(data, tmp_path, capsys):
    path = written(tmp_path, FILE.format(data=data, out=tmp_path / "runs"))
    assert main(["run", "--config", str(path), "--samples", "2", "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)["report"]["runs"]
    records = [RunFolder.open(run["folder"]).record for run in runs]
    assert [(record.method.name, record.condition, record.seed) for record in records] == [
        ("ground-truth", "none", 0),
        ("ground-truth", "none", 1),
        ("scripted", "goal-loc", 0),
        ("scripted", "goal-loc", 1),
        ("scripted", "none", 0),
        ("scripted", "none", 1),
    ]
    record = RunFolder.open(tmp_path / "runs" / "scripted-shuffled-goal-goal-loc-seed1").record
    assert (record.seed, record.limit, record.control, record.samples) == (1, 3, "shuffled-goal", 2)


def test_what_a_command_line_means_is_a_file_that_means_the_same(data, tmp_path, capsys):
    words = ["run", "--method", "pr", "--condition", "goal-loc", "--data", str(data), "--option", "steps=20"]
    words += ["--seed", "4", "--limit", "2", "--weights", "mine.safetensors"]
    assert main([*words, "--show-config"]) == 0
    path = written(tmp_path, capsys.readouterr().out)
    (request,) = read_experiment(path).requests()
    assert (request.method, request.condition, request.seed, request.limit) == ("pr", Condition.GOAL_LOCATION, 4, 2)
    assert (dict(request.options), request.data) == ({"steps": "20"}, (data,))
    assert str(request.weights) == "mine.safetensors"
    assert main(["run", "--config", str(path), "--show-config"]) == 0
    assert capsys.readouterr().out == path.read_text()


def test_an_option_of_the_command_line_replaces_the_files_and_a_default_does_not(data, tmp_path, capsys):
    path = written(tmp_path, FILE.format(data=data, out="runs").replace("limit = 3", 'limit = 3\ndevice = "cuda"'))
    assert main(["run", "--config", str(path), "--limit", "5", "--seed", "7", "--show-config"]) == 0
    meant = read_experiment(written(tmp_path, capsys.readouterr().out))
    assert (meant.limit, meant.seeds, meant.device) == (5, (7,), "cuda")


def test_options_are_written_as_a_command_line_writes_them():
    typed = """
data = ["t"]
[[methods]]
name = "x"
options = { fast = true, steps = 3, scale = 0.5, words = "a b" }
"""
    (request,) = msgspec.toml.decode(typed, type=Experiment).requests()
    assert dict(request.options) == {"fast": "true", "steps": "3", "scale": "0.5", "words": "a b"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("methods = []", "methods'?: expected one entry or more"),
        ("[[methods]]\nname = 'x'\nwieghts = 'y'", "wieghts"),
        ("sed = 3\n[[methods]]\nname = 'x'", "sed"),
        ("[[methods]]\nconditions = ['goal']\nname = 'x'", "goal"),
        ("[[methods]]\nname = 3", r"methods\[0\].name: expected a value of the key's type"),
        ("methods", "expected a TOML file"),
    ],
)
def test_a_wrong_file_is_refused_with_its_key(text, message, tmp_path):
    with pytest.raises(InputFileError, match=message):
        read_experiment(written(tmp_path, text))


def test_two_runs_of_one_name_are_refused(data, tmp_path):
    text = 'data = ["t"]\n[[methods]]\nname = "x"\n[[methods]]\nname = "x"\nweights = "w"\n'
    with pytest.raises(UsageError, match="two runs of the experiment are called 'x'"):
        list(read_experiment(written(tmp_path, text)).requests())


@pytest.mark.parametrize(
    "given", [["--method", "pr"], ["--condition", "none"], ["--option", "a=b"], ["--weights", "w"]]
)
def test_what_belongs_to_one_method_stands_in_the_file(data, tmp_path, capsys, given):
    path = written(tmp_path, FILE.format(data=data, out="runs"))
    assert main(["run", "--config", str(path), *given]) == 2
    assert f"{given[0]}: " in capsys.readouterr().err


def test_a_repeated_run_gives_the_same_scores_and_says_so(data, tmp_path, capsys):
    first = tmp_path / "first"
    words = ["--method", "scripted", "--condition", "goal-loc", "--data", str(data), "--control", "shuffled-goal"]
    assert main(["run", *words, "--seed", "3", "--limit", "5", "--batch-size", "2", "--out", str(first)]) == 0
    again = ["run", "--config", str(first / "run.json"), "--out", str(tmp_path / "second")]
    capsys.readouterr()
    assert main(again) == 7
    assert "neither named with --data nor embedded" in capsys.readouterr().err
    assert main([*again, "--data", str(data)]) == 0
    assert "every score is the same" in capsys.readouterr().err
    assert (tmp_path / "second" / "run.json").read_bytes() == (first / "run.json").read_bytes()
    assert same_scores(RunFolder.open(first), RunFolder.open(tmp_path / "second"))
    other = ["run", "--config", str(first), "--data", str(data), "--limit", "4", "--out", str(tmp_path / "third")]
    assert main(other) == 2
    assert "--limit: " in capsys.readouterr().err
    assert not (tmp_path / "third").exists()


def test_only_a_run_folder_or_its_record_is_a_run(tmp_path):
    assert earlier_run(tmp_path / "experiment.toml") is None


def test_more_samples_than_a_run_can_finish_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('data = ["table"]\nsamples = 4294967296\n[[methods]]\nname = "static"\nconditions = ["none"]\n')
    with pytest.raises(InputFileError, match=r"samples.*<= 100000"):
        read_experiment(path)
