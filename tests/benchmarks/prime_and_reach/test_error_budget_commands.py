"""``prbench analyse errors``: budgets of runs, alone and beside one another, printed, as JSON and one row a motion."""

from __future__ import annotations

import shutil

import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from prbench.cli import main
from prbench.harness.run_folder import DatasetSummary
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A table, and runs of two controls and of recorded people on it."""
    made = tmp_path_factory.mktemp("budget")
    table = str(fake_dataset(made / "table", 48).folder)
    for method, name in (("nearest-neighbour", "run"), ("scripted", "other"), ("ground-truth", "people")):
        words = ["run", "--method", method, "--data", table, "--split", "validation", "--out", str(made / name)]
        assert main([*words, "-q"]) == 0
    return made


def budget(folder, capsys, *words, run="run"):
    given = ["analyse", "errors", str(folder / run), "--data", str(folder / "table"), *map(str, words)]
    return reported(given, capsys)


def rows_of(report, title: str) -> dict[str, dict[str, float]]:
    """The rows of the table whose title begins so: numbers by metric."""
    (table,) = (table for table in report.tables if table.title.startswith(title))
    return {
        row.text["group"]: {cell.metric: cell.value for cell in row.cells}
        for block in table.blocks
        for row in block.rows
    }


def test_shares_add_up_and_rates_are_those_of_the_run(folder, capsys):
    (path,) = (folder / "run").rglob("summary.json")
    scores = {metric.metric: 100 * metric.mean for metric in DatasetSummary.read(path.parent).metrics}
    report = budget(folder, capsys)
    looking = rows_of(report, "Prime Success, and why")
    for numbers in looking.values():
        causes = [value for name, value in numbers.items() if name not in ("sequences", "people")]
        assert sum(causes) == pytest.approx(100)
    reaching = rows_of(report, "Reach Success, and why")
    for numbers in reaching.values():
        causes = [value for name, value in numbers.items() if name not in ("sequences", "people", "smallest")]
        assert sum(causes) == pytest.approx(100)
    assert looking["all"]["sequences"] == 12
    assert looking["all"]["primed"] == pytest.approx(scores["prime_success"])
    assert reaching["all"]["reached"] == pytest.approx(scores["reach_success"])
    bodies = rows_of(report, "Feet and bones")["all"]
    assert bodies["skating"] == pytest.approx(scores["foot_skating"])
    assert bodies["bone_change"] == pytest.approx(scores["bone_length_change"])
    for rate in ("Prime Success", "Reach Success"):
        each = rows_of(report, f"{rate}: where sequences")["all"]
        assert sum(each[name] for name in PARTS) == pytest.approx(100)
        assert each["best_of_k"] == pytest.approx(each["always"] + each["noise"])
    bearings = [numbers["sequences"] for name, numbers in looking.items() if name.startswith("bearing")]
    assert sum(bearings) == 12


PARTS = ("always", "noise", "optimisation", "representation", "not_learnt", "nor_people")


def test_recorded_motion_is_people(folder, capsys):
    report = budget(folder, capsys, run="people")
    for title in ("Prime Success, and why", "Reach Success, and why", "Feet and bones"):
        rows = rows_of(report, title)
        assert rows["all"] == rows["recorded people"]
    primed = rows_of(report, "Prime Success: where")["all"]
    assert (primed["representation"], primed["not_learnt"]) == (0, 0)
    assert primed["people"] == primed["mean"] == primed["always"]


def test_a_run_beside_gains_and_loses(folder, capsys):
    report = budget(folder, capsys, "--beside", folder / "other")
    primed = rows_of(report, "Beside other")["Prime Success"]
    assert primed["sequences"] == 12
    assert primed["rate"] + primed["gained"] - primed["lost"] == pytest.approx(primed["rate_beside"])
    assert rows_of(report, "Prime Success: where")["all"]["optimisation"] == pytest.approx(primed["gained"])
    gains = rows_of(report, "Gain")["all, elevation"]
    assert {name.split()[0] for name in gains} == {"method", "people", "beside"}


def test_every_motion_is_a_row(folder, tmp_path, capsys):
    report = budget(folder, capsys, "--out", tmp_path / "out")
    assert report.out == tmp_path / "out"
    rows = pq.read_table(tmp_path / "out" / "motions.parquet")
    assert rows.num_rows == 36  # twelve sequences of the method, of people, and of people through the features
    assert {"run", "who", "sequence_id", "look_cause", "look_miss_up_deg", "reach_cause"} <= set(rows.column_names)
    assert pyarrow.csv.read_csv(tmp_path / "out" / "motions.csv").num_rows == 36


def test_the_report_fits_on_a_terminal(folder, capsys):
    words = [
        "analyse",
        "errors",
        str(folder / "run"),
        "--beside",
        str(folder / "other"),
        "--data",
        str(folder / "table"),
    ]
    assert main([*words, "-q"]) == 0
    shown = capsys.readouterr().out
    assert "Gain: slope of the ray's angle against the goal's" in shown
    assert max(map(len, shown.splitlines())) <= 100


def test_a_run_without_table_or_motions_is_refused(folder, tmp_path, capsys):
    refused(["analyse", "errors", str(folder / "run")], capsys, code=4, message="Name it with --data DIR")
    bare = tmp_path / "bare"
    shutil.copytree(folder / "run", bare)
    shutil.rmtree(bare / "synthetic-adt/predictions")
    words = ["analyse", "errors", str(bare), "--data", str(folder / "table")]
    refused(words, capsys, code=7, message="expected the motions of the run, found none")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["errors", "r", "--fan", "f.png"], "analyse errors takes no --fan; its options: --beside, --data, --out."),
        (["agreement", "r", "--out", "."], "is a directory"),
        (["diversity", "a", "b"], "analyse diversity: name one RUN."),
        (["diversities", "a"], "'diversities' is not one of"),
    ],
)
def test_what_a_kind_does_not_take_is_refused(words, message, capsys):
    refused(["analyse", *words], capsys, code=2, message=message)
