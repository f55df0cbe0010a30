"""``prbench study ITEM --train``: rows are trained, run, resumed, shared, stamped; a failing one costs no other."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from prbench.cli.main import main
from prbench.engine import InProcess
from prbench.errors import UsageError
from prbench.harness.first_run import table_finder
from prbench.harness.results import RunChecker
from prbench_adapters.training.ablations import load_ablations
from prbench_benchmarks.prime_and_reach import ablation
from prbench_benchmarks.prime_and_reach.ablation import TABLES, AblationRequest, ablation_table, run_ablation
from tests.fakes import fake_dataset
from tests.tables.test_tables import require_whole_latex


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ablation") / "table"
    fake_dataset(folder, n=24)
    return folder


@pytest.fixture(scope="module")
def made(data, tmp_path_factory) -> Path:
    """Table S5 at smoke size: two rows that share their pre-training."""
    out = tmp_path_factory.mktemp("made")
    assert main(_words(data, out)) == 0
    return out


def _words(data: Path, out: Path) -> list[str]:
    return ["study", "table-s5", "--train", "--data", str(data), "--config", "smoke", "--limit", "2", "--out", str(out)]


def checked(data):
    return RunChecker(table_finder([data])).check


def test_the_tables_are_the_study_s():
    assert TABLES == ("3", "4", "S4", "S5", "S6", "S7")


def test_rows_are_trained_run_and_written(made):
    folder = made / "smoke"
    assert sorted(path.name for path in (folder / "runs").iterdir()) == [
        "pr-nymeria-goal-location-joint-loss-weight-0-0-optimise-paper",
        "pr-nymeria-goal-location-optimise-paper",
    ]
    assert len(list(folder.glob("mdm-*"))) == 1
    assert {path.name for path in folder.glob("table_s5.*")} == {"table_s5.csv", "table_s5.tex", "table_s5.md"}


def test_a_smoke_table_is_stamped_everywhere(made, data):
    (table,) = ablation_table("S5", made / "smoke", checked(data), with_published=True)
    assert table.stamp == "NOT THE STUDY'S CONFIGURATION: 4 steps of 250000"
    latex = (made / "smoke" / "table_s5.tex").read_text()
    assert "NOT THE STUDY" in latex.split(r"\label")[0]
    require_whole_latex(latex)
    assert len(table.blocks[0].rows) == 2
    assert [block.title for block in table.blocks[1:]] == [
        "Published: Prime and Reach, Table S5, hd-epic",
        "Published: Prime and Reach, Table S5, mogaze",
    ]


def test_the_same_command_goes_on_and_makes_nothing_again(made, data):
    motions = {path: path.stat().st_mtime_ns for path in made.rglob("part-*.parquet")}
    weights = {path: path.read_bytes() for path in made.rglob("weights.safetensors")}
    assert (len(motions), len(weights)) == (2, 3)
    assert main(_words(data, made)) == 0
    assert motions == {path: path.stat().st_mtime_ns for path in motions}
    assert weights == {path: path.read_bytes() for path in weights}


def test_weights_of_another_training_are_not_believed(made, data, tmp_path):
    folder = tmp_path / "forged"
    shutil.copytree(made / "smoke", folder)
    row = next(row for row in load_ablations() if row.table == "S5")
    (folder / row.training_name / "weights.safetensors").write_bytes(b"other")
    (table,) = ablation_table("S5", folder, checked(data), with_published=False)
    assert table.stamp.startswith("TRAINING UNKNOWN")


def test_rows_that_were_not_run_are_named(made, data):
    (table,) = ablation_table("S4", made / "smoke", checked(data), with_published=False)
    assert [block.title for block in table.blocks][1] == "Not run, or not finished"
    assert [row.text["method"] for row in table.blocks[1].rows] == ["encoder"]


def test_a_failing_row_costs_no_other(data, tmp_path, monkeypatch):
    tried = []

    def train(request, **_):
        tried.append(request.out.name)
        raise RuntimeError("out of memory")

    monkeypatch.setattr(ablation, "train", train)
    request = AblationRequest(table="4", data=(data,), out=tmp_path, configuration="smoke")
    _, failed = run_ablation(request, engine=InProcess(), say=lambda _: None)
    assert set(failed) == {"no pre-training", "pre-trained on HumanML3D", "pre-trained on Nymeria"}
    assert set(failed.values()) == {"RuntimeError: out of memory"}
    assert len(tried) == 3


def test_a_corpus_is_asked_for_before_anything_is_trained(data, tmp_path):
    with pytest.raises(UsageError, match="name its folder with --nymeria DIR"):
        AblationRequest(table="3", data=(data,), out=tmp_path)
    with pytest.raises(UsageError, match="no ablations in table '9'"):
        AblationRequest(table="9", data=(data,), out=tmp_path)


def test_a_row_runs_with_the_study_s_options_unless_it_is_a_smoke_test(data, tmp_path):
    corpora = {"nymeria": data, "humanml3d": data}
    paper = AblationRequest(table="3", data=(data,), out=tmp_path, corpora=corpora)
    assert [paper.options_of(row) for row in paper.rows] == [dict(row.options) for row in paper.rows]
    assert paper.folder == tmp_path / "paper"


def test_the_report_says_what_is_there(made, data, capsys):
    assert main([*_words(data, made), "--json", "-q"]) == 0
    report = json.loads(capsys.readouterr().out)["report"]
    assert len(report["runs"]) == 2
    assert report["failed"] == {}
    assert all("NOT THE STUDY'S" in stamp for stamp in [table["stamp"] for table in report["tables"]])
