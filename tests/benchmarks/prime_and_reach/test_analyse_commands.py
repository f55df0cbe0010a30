"""``prbench analyse``: agreement, diversity and errors of finished runs, printed, as JSON, and how each refuses."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import DatasetSummary
from prbench.sequences import SequenceTable
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset
from tests.method_fixtures import adapter_source, install, own_cache

__all__ = ["install", "own_cache"]


def test_agreement_of_runs_is_printed_and_reported(tmp_path, capsys):
    table = str(fake_dataset(tmp_path / "table", 48).folder)
    run = str(tmp_path / "run")
    words = ["run", "--method", "nearest-neighbour", "--data", table, "--out", run]
    (made,) = reported(words, capsys).runs
    assert main(words) == 0
    assert "agreement with recorded people (phi): Prime Success" in capsys.readouterr().out
    out = tmp_path / "agreement.json"
    rates, by_place = reported(["analyse", "agreement", run, "--data", table, "--out", str(out)], capsys).tables
    assert json.loads(out.read_text())["command"] == "analyse"
    (stored,) = made.agreements
    assert [row.cells[0].value for row in rates.blocks[0].rows] == [rate.phi for rate in stored.rates]
    assert [row.text["sequences"] for row in by_place.blocks[0].rows] == [str(e.sequences) for e in stored.breakdown]
    assert not any("unverified" in note for note in by_place.notes)
    assert main(["analyse", "agreement", run]) == 0
    shown = capsys.readouterr().out
    assert "bearing 30 to 90°" in shown
    assert "height from 1.4 m" in shown
    assert "unverified: its table of synthetic-adt is not at hand" in shown


GENTLE = "joints = batch.initial_joints[:, None] + 0.05 * joints if batch.initial_joints is not None else joints"


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> SequenceTable:
    return fake_dataset(tmp_path_factory.mktemp("data") / "table", 60)


def measures_of(words, capsys) -> tuple[dict[str, dict], str]:
    """Cells of each measure by what they are of, and the notes."""
    (table,) = reported(words, capsys).tables
    rows = table.blocks[0].rows
    return {row.cells[0].variant: {cell.metric: cell for cell in row.cells} for row in rows}, " ".join(table.notes)


def made_run(table: SequenceTable, out: Path, **changes) -> str:
    wanted = {"method": "made", "condition": Condition.GOAL_LOCATION, "samples": 3, "limit": 8}
    run_method(RunRequest(**{**wanted, "data": (table.folder,), "out": out, **changes}))
    return str(out)


def test_spreads_stand_beside_those_of_people_with_intervals(table, tmp_path, install, capsys):
    install("made", adapter_source(body=GENTLE))
    run = made_run(table, tmp_path / "run")
    words = ["analyse", "diversity", run, "--data", str(table.folder)]
    by_name, notes = measures_of(words, capsys)
    assert "m apart in median" in notes
    joint = by_name["apd_joint"]
    # Noise of 5 cm in each coordinate, independently in two motions.
    assert joint["method"].value == pytest.approx(0.05 * 6**0.5, rel=0.02)
    assert joint["method"].sequences == 8
    assert joint["difference"].value == pytest.approx(joint["method"].value - joint["people"].value)
    assert joint["difference"].low is not None
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "3 motions of each of 8 sequences" in shown
    assert "Prime time" in shown
    assert "an upper bound of what one task brings forth" in shown
    assert "These are scores on synthetic data: never compare them with published ones." in shown


def test_recorded_motion_drawn_several_times_has_no_spread(table, tmp_path, capsys):
    run = made_run(table, tmp_path / "run", method="ground-truth", condition=None)
    found, _ = measures_of(["analyse", "diversity", run, "--data", str(table.folder)], capsys)
    assert [each["method"].value for each in found.values()] == pytest.approx([0.0] * len(found), abs=1e-12)
    assert all(each["people"].value > 0 for each in list(found.values())[:4])


@pytest.mark.parametrize("name", ["fan.png", "fan.svg"])
def test_a_fan_is_drawn_and_the_same_bytes_again(table, tmp_path, install, capsys, name):
    install("made", adapter_source(body=GENTLE))
    run = made_run(table, tmp_path / "run")
    sequence = pq.read_table(tmp_path / "run/synthetic-adt/predictions", columns=["sequence_id"])["sequence_id"][
        0
    ].as_py()
    pictures = []
    for folder in ("one", "two"):
        out = tmp_path / folder / name
        out.parent.mkdir()
        words = ["analyse", "diversity", run, "--data", str(table.folder), "--fan", str(out), "--sequence", sequence]
        assert reported(words, capsys).fan_sequence == sequence
        pictures.append(out.read_bytes())
    assert pictures[0] == pictures[1]
    assert len(pictures[0]) > 10_000


def test_a_run_that_cannot_be_measured_is_refused_with_what_to_do(table, tmp_path, install, capsys):
    install("made", adapter_source(body=GENTLE))
    data = ["--data", str(table.folder)]
    single = made_run(table, tmp_path / "single", samples=1)
    shuffled = made_run(table, tmp_path / "shuffled", control="shuffled-goal")
    run = made_run(table, tmp_path / "run")
    for words, message in (
        ([single], "expected two motions or more of each sequence, found one"),
        ([shuffled], "were given other sequences' goals"),
        ([run, "--sequence", "x"], "--sequence: belongs to --fan FILE"),
        ([run, "--fan", str(tmp_path / "fan.mp4")], "written as .png or .svg"),
        ([run, "--fan", str(tmp_path / "fan.png"), "--sequence", "nowhere"], "nowhere"),
    ):
        assert main(["analyse", "diversity", *words, *data]) == 2
        assert message in capsys.readouterr().err
    for part in (tmp_path / "run/synthetic-adt/predictions").iterdir():
        part.unlink()
    assert main(["analyse", "diversity", run, *data]) != 0
    assert "expected the predictions of a run, found none" in capsys.readouterr().err


def test_a_table_of_one_recording_has_no_people_beside(tmp_path, install, capsys, monkeypatch):
    install("made", adapter_source(body=GENTLE))
    table = fake_dataset(tmp_path / "table", 12, recordings=1)
    run = made_run(table, tmp_path / "run", split="train", limit=None)
    found, notes = measures_of(["analyse", "diversity", run, "--data", str(table.folder)], capsys)
    assert "too few recordings to put people beside one another" in notes
    assert all(set(each) == {"method"} for each in found.values())


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
    runs = [str(folder / name) for name in ("run", "other", "table")]
    assert main(["analyse", "errors", runs[0], "--beside", runs[1], "--data", runs[2], "-q"]) == 0
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
