"""``prbench study prediction --train``: rows are trained, run, resumed, stamped; a failing one costs no other."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from prbench.cli.main import main
from prbench.engine import InProcess
from prbench.errors import UsageError
from prbench_adapters.prediction.configuration import PRESETS
from prbench_adapters.training.rows import RowsRequest
from prbench_benchmarks.motion_prediction import study_tables, trained_tables
from prbench_benchmarks.motion_prediction.study_tables import PredictionTables, load_tables
from prbench_benchmarks.motion_prediction.table import WindowsTable
from prbench_benchmarks.motion_prediction.trained_tables import _changes, _configuration, train_prediction
from tests.benchmarks.motion_prediction.windows import walking, write

SHOWN = ("cvae", "dlow", "no-cross-attention", "gazemodiff", "")


@pytest.fixture(autouse=True)
def few_rows(monkeypatch):
    """Methods with a first stage, an ablation with its whole method, and what needs no training."""
    tables = load_tables()
    rows = tuple(row for row in tables.rows if row.weights in SHOWN)
    few = PredictionTables(titles=tables.titles, rows=rows)
    for module in (study_tables, trained_tables):
        monkeypatch.setattr(module, "load_tables", lambda: few)


@pytest.fixture(scope="module")
def windows(tmp_path_factory) -> Path:
    splits = ("test", "train", "train", "train")
    runs = [walking(f"r{n}", 110, number=n, split=split) for n, split in enumerate(splits)]
    return write(tmp_path_factory.mktemp("windows") / "w", *runs)


def words(windows: Path, out: Path, *more: str) -> list[str]:
    return [
        "study",
        "prediction",
        "--train",
        str(windows),
        "--config",
        "smoke",
        "--limit",
        "2",
        "--out",
        str(out),
        *more,
    ]


def request(*windows: Path, out: Path, configuration: str = "smoke") -> RowsRequest:
    return RowsRequest(data=windows, out=out, configuration=configuration, limit=2)


def made(asked: RowsRequest):
    return train_prediction(asked, engine=InProcess(), say=lambda _: None, tell=lambda *_: None)


def test_one_command_trains_runs_and_draws_and_the_same_one_makes_nothing_again(windows, tmp_path, capsys):
    assert main([*words(windows, tmp_path), "--json", "-q"]) == 0
    folder = tmp_path / "smoke"
    report = json.loads(capsys.readouterr().out)["report"]
    assert [Path(path).name for path in report["runs"]] == [
        "cvae-pose",
        "dlow-pose",
        "no-cross-attention-pose-gaze",
        "gazemodiff-pose-gaze",
    ]
    assert {path.name for path in folder.iterdir() if path.is_file()} == {
        "prediction.csv",
        "prediction.md",
        "prediction.tex",
        "prediction-synthetic-walks.png",
    }
    first, third = report["tables"][0], report["tables"][2]
    assert first["stamp"] == "NOT THE STUDY'S CONFIGURATION: 6 steps of 39000"
    assert "GazeMoDiff: NOT THE STUDY'S CONFIGURATION: 6 steps of 468600." in third["notes"]
    # A row is its own run: the ablation does not stand for the whole method.
    ade = {row["text"]["method"]: row["cells"][0]["value"] for row in third["blocks"][0]["rows"] if row["cells"]}
    assert ade["GazeMoDiff"] != ade["GazeMoDiff, no cross-attention"]
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("part-*.parquet")}
    weights = {path: path.read_bytes() for path in folder.rglob("weights.safetensors")}
    assert (len(before), len(weights)) == (4, 4)
    table = (folder / "prediction.csv").read_bytes()
    assert main([*words(windows, tmp_path), "-q"]) == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert weights == {path: path.read_bytes() for path in weights}
    assert table == (folder / "prediction.csv").read_bytes()


def test_a_failing_row_costs_no_other_and_no_bundled_weights_take_its_place(windows, tmp_path, monkeypatch):
    tried = []

    def train(request, **_):
        tried.append((request.method, request.initial))
        raise RuntimeError("out of memory")

    monkeypatch.setattr(trained_tables, "train", train)
    found = made(request(windows, out=tmp_path))
    assert set(found.failed.values()) == {"RuntimeError: out of memory"}
    assert len(tried) == len(found.failed) == 4
    assert tried[1] == ("dlow", tmp_path / "smoke" / "synthetic-walks" / "cvae" / "weights.safetensors")
    (table, *_) = found.tables["synthetic-walks"]
    cells = {row.text["method"]: row.cells for row in table.blocks[0].rows}
    assert not cells["GazeMoDiff"]
    assert cells["zero velocity"]
    assert any("GazeMoDiff: RuntimeError: out of memory" in note for note in table.notes)


def test_what_does_not_fit_is_refused_before_anything_is_trained(windows, tmp_path):
    with pytest.raises(UsageError, match="both hold synthetic-walks"):
        made(request(windows, write(tmp_path / "other"), out=tmp_path / "out"))
    with pytest.raises(UsageError, match="has no configuration 'tiny'"):
        made(request(windows, out=tmp_path / "out", configuration="tiny"))
    with pytest.raises(UsageError, match="several methods"):
        made(request(windows, out=tmp_path / "out", configuration="mine.toml"))
    assert not (tmp_path / "out").exists()
    assert main(["study", "prediction", "--train"]) == 2
    assert main([*words(windows, tmp_path), "--data", str(windows)]) == 2


def test_an_ablation_changes_its_part_alone_and_tested_windows_are_not_learnt_from(windows, monkeypatch):
    rows = {row.weights: row for row in load_tables().rows}
    table = WindowsTable.open(windows)
    expected = (("model.cross_attention", "false"), ("model.windows.condition", "pose+gaze"))
    assert _changes(rows["no-cross-attention"], table) == expected
    assert PRESETS["no-cross-attention"] == {"cross_attention": False}
    monkeypatch.setattr(trained_tables, "split_column", lambda _: "published_split")
    assert ("model.windows.split", "published") in _changes(rows["cvae"], table)


def test_methods_with_one_source_have_one_published_configuration():
    rows = {row.weights: row for row in load_tables().rows}
    assert _configuration(rows["gazemodiff"], "code") == "code"
    assert _configuration(rows["cvae"], "code") == "paper"
    assert _configuration(rows["cvae"], "small") == "small"
