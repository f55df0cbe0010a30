"""Stored scores and summaries are compared with what follows from motions and scores; forged runs are refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.errors import RunError
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker, differences, require_scores, summary_of, tree_of
from prbench.harness.run import run_method
from prbench.harness.run_folder.folder import DatasetFolder, RunFolder
from prbench.harness.run_folder.scores import SCORES, CodedScores, read_scores
from prbench.harness.run_folder.summary import MetricSummary
from prbench.sequences import SequenceTable
from prbench.sequences.sequence import recording_key
from tests.fakes import fake_dataset
from tests.harness.run_folder.test_record import METRIC, SUMMARY

ENTRY = msgspec.structs.replace(METRIC, mean=0.25, low=0.2, high=0.3, interval="student-cr2")


def tree(entry: MetricSummary) -> dict[str, object]:
    return tree_of(msgspec.structs.replace(SUMMARY, metrics=(entry,)))


# Bounds of 0.206 passed here while version 0.5.0 drew its bootstrap; no bound is drawn any more.
@pytest.mark.parametrize(("low", "differs"), [(0.2, False), (0.2 + 1e-8, False), (0.206, True), (0.0, True)])
def test_bounds_follow_from_the_scores(low: float, differs: bool) -> None:
    found = list(differences(tree(ENTRY), tree(msgspec.structs.replace(ENTRY, low=low))))
    assert found == ([("mpjpe.low", 0.2, low)] if differs else [])


def test_another_estimator_is_named_before_its_bounds() -> None:
    stored = msgspec.structs.replace(ENTRY, low=0.21, interval="bootstrap")
    assert next(differences(tree(ENTRY), tree(stored)))[0] == "mpjpe.interval"


def coded(*values: float, **changes: object) -> CodedScores:
    rows = [{"sequence_id": str(i), "dataset": "d", "sample": 0, "metric": "mpjpe", "value": value} | changes
            for i, value in enumerate(values)]  # fmt: skip
    return CodedScores.of([pa.Table.from_pylist(rows, schema=SCORES)])


@pytest.mark.parametrize(
    ("made", "stored", "message"),
    [
        (0.25, 0.25 + 0.9e-6, ""),  # other processors round another way
        (0.25, 0.25 + 1.2e-6, "row 1 .1, sample 0, mpjpe.: expected 0.25, .* found 0.250001 .1 of 2 values differ."),
        (0.25, 0.252, "found 0.252"),
        (0.25, 0.25 - 1.2e-6, "found 0.249999"),
        (1000.0, 1000.0009, ""),
        (1000.0, 1000.0011, "found 1000"),
        (0.25, float("nan"), "found nan"),
        (float("nan"), 0.25, "expected nan"),
    ],
)
def test_scores_differ_by_less_than_a_millionth_from_those_of_the_motions(tmp_path, made, stored, message) -> None:
    if not message:
        require_scores(DatasetFolder(tmp_path), coded(0.5, stored), coded(0.5, made))
        return
    with pytest.raises(RunError, match=message):
        require_scores(DatasetFolder(tmp_path), coded(0.5, stored), coded(0.5, made))


@pytest.mark.parametrize(
    ("stored", "message"),
    [
        (coded(0.5, 0.25, metric="goal_mpjpe"), "row 0: expected 0, sample 0, mpjpe from .* found 0, sample 0, goal_m"),
        (coded(0.5, 0.25, flag="x"), "row 0: expected 0, sample 0, mpjpe from .* found 0, sample 0, mpjpe, x .2 and 2"),
        (coded(0.5, 0.25, sample=1), "found 0, sample 1, mpjpe"),
        (coded(0.5), r"row 1: expected 1, sample 0, mpjpe from .* found no row \(2 and 1 rows\)"),
        (coded(0.5, 0.25, 0.1), "row 2: expected no row from the motions and their table, found 2, sample 0, mpjpe"),
    ],
)
def test_scores_have_the_rows_of_the_motions(tmp_path, stored, message) -> None:
    with pytest.raises(RunError, match=message):
        require_scores(DatasetFolder(tmp_path), stored, coded(0.5, 0.25))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table, and runs of two controls on it."""
    root = tmp_path_factory.mktemp("verified")
    table = fake_dataset(root / "table", 32, recordings=16).folder
    for method in ("scripted", "ground-truth"):
        run_method(RunRequest(method=method, data=(table,), out=root / method))
    return root


@pytest.fixture
def runs(made: Path, tmp_path: Path) -> Path:
    """A copy to forge."""
    shutil.copytree(made, tmp_path / "copy")
    return tmp_path / "copy"


def checked(folder: Path, data: Path | None):
    run = RunFolder.open(folder)
    table = None if data is None else SequenceTable.open(data)
    return RunChecker(lambda _: table).check(run, run.record.tables[0])


def edit_scores(folder: Path, change: Callable[[np.ndarray], np.ndarray], metric: str = "mpjpe") -> None:
    scores = pq.read_table(folder / "synthetic-adt/scores.parquet")
    values = scores["value"].to_numpy().copy()
    chosen = np.array(scores["metric"].to_pylist()) == metric
    values[chosen] = change(values[chosen])
    index = scores.schema.get_field_index("value")
    pq.write_table(
        scores.set_column(index, scores.schema.field(index), pa.array(values)), folder / "synthetic-adt/scores.parquet"
    )


def edit_summary(folder: Path, **changes: object) -> None:
    path = folder / "synthetic-adt/summary.json"
    summary = json.loads(path.read_text())
    entry = next(metric for metric in summary["metrics"] if metric["metric"] == "prime_success")
    entry.update(changes)
    path.write_text(json.dumps(summary))


def fit_summary_to_scores(folder: Path) -> None:
    """The summary that fits the scores, as a careful forger leaves it."""
    run = RunFolder.open(folder)
    scores = read_scores(folder / "synthetic-adt/scores.parquet")
    names = set(scores["sequence_id"].to_pylist())
    summary_of(run.record, run.record.tables[0], scores, {name: recording_key(name) for name in names}).write(
        folder / "synthetic-adt"
    )


NEWER = ("prime_success_arrival", "prime_success_angle", "plausible", "first_step", "largest_speed")


def without_newer_metrics(folder: Path) -> None:
    """Leave scores and summary as a version wrote them that did not know some of the metrics."""
    scores = pq.read_table(folder / "synthetic-adt/scores.parquet")
    older = ~np.isin(scores["metric"].to_pylist(), NEWER)
    pq.write_table(scores.filter(pa.array(older)), folder / "synthetic-adt/scores.parquet")
    fit_summary_to_scores(folder)


def under_an_older_protocol(folder: Path) -> None:
    record = json.loads((folder / "run.json").read_text())
    record["protocol_digest"] = "c5c5" * 16
    (folder / "run.json").write_text(json.dumps(record))


def test_a_run_of_an_older_protocol_is_read_with_the_metrics_that_it_has(runs: Path) -> None:
    without_newer_metrics(runs / "scripted")
    under_an_older_protocol(runs / "scripted")
    found = checked(runs / "scripted", runs / "table")
    names = [metric.metric for metric in found.summary.metrics]
    assert "prime_success" in names
    assert not set(NEWER) & set(names)
    assert "another protocol" in found.unverified
    assert "`prbench score RUN --data DIR`" in found.unverified


def test_the_motions_of_a_run_of_an_older_protocol_are_scored_by_todays(runs: Path, capsys) -> None:
    before = {metric.metric: metric.mean for metric in checked(runs / "scripted", runs / "table").summary.metrics}
    without_newer_metrics(runs / "scripted")
    under_an_older_protocol(runs / "scripted")
    out = runs / "again"
    assert main(["score", str(runs / "scripted"), "--data", str(runs / "table"), "--out", str(out), "--all"]) == 0
    assert "Prime Success (arrival)" in capsys.readouterr().out
    means = read_scores(out / "synthetic-adt/scores.parquet").group_by("metric").aggregate([("value", "mean")])
    assert dict(zip(means["metric"].to_pylist(), means["value_mean"].to_pylist())) == pytest.approx(before)


def test_a_run_of_an_older_protocol_with_an_edited_summary_is_refused_all_the_same(runs: Path) -> None:
    without_newer_metrics(runs / "scripted")
    under_an_older_protocol(runs / "scripted")
    edit_summary(runs / "scripted", mean=0.123)
    with pytest.raises(RunError, match=r"prime_success\.mean"):
        checked(runs / "scripted", runs / "table")


def test_under_todays_protocol_no_metric_may_be_left_out(runs: Path) -> None:
    without_newer_metrics(runs / "scripted")
    with pytest.raises(RunError, match="prime_success_arrival"):
        checked(runs / "scripted", runs / "table")


def test_a_run_that_nobody_touched_is_verified_on_its_table_only(made: Path) -> None:
    found = checked(made / "scripted", made / "table")
    assert found.unverified == ""
    assert found.summary.sequences == 8
    assert "name it with --data" in checked(made / "scripted", None).unverified


def test_a_summary_made_without_the_table_is_that_of_the_run(made: Path) -> None:
    assert checked(made / "scripted", None).summary == checked(made / "scripted", made / "table").summary


@pytest.mark.parametrize(
    "changes", [{"mean": 1.0}, {"high": 0.1}, {"low": None}, {"sequences": 80}, {"flags": {"x": 3}}, {"recordings": 9}]
)
def test_an_edited_summary_is_refused_with_what_differs(runs: Path, changes: dict[str, object]) -> None:
    edit_summary(runs / "scripted", **changes)
    with pytest.raises(RunError, match=rf"summary\.json, prime_success\.{next(iter(changes))}[.:]"):
        checked(runs / "scripted", None)


def test_edited_scores_beside_the_old_summary_are_refused_without_a_table(runs: Path) -> None:
    edit_scores(runs / "scripted", lambda values: values * 0)
    with pytest.raises(
        RunError, match=r"summary\.json, mpjpe\.(mean: expected 0\.0|interval: expected none), .* found (0\.|student)"
    ):
        checked(runs / "scripted", None)


@pytest.mark.parametrize("edit", [lambda values: values * 0, lambda values: values * 0.996], ids=["all", "0.4 %"])
def test_edited_scores_with_a_summary_that_fits_are_refused_on_the_table(runs: Path, edit: Any) -> None:
    edit_scores(runs / "scripted", edit)
    fit_summary_to_scores(runs / "scripted")
    assert checked(runs / "scripted", None).unverified
    with pytest.raises(RunError, match=r"scores\.parquet, row \d+ .*mpjpe.*: expected 0\.\d+, which the motion"):
        checked(runs / "scripted", runs / "table")


def test_scores_without_the_worst_sequence_are_refused(runs: Path) -> None:
    folder = runs / "scripted"
    scores = pq.read_table(folder / "synthetic-adt/scores.parquet")
    gone = scores["sequence_id"][0].as_py()
    kept = scores.filter(pc.field("sequence_id") != gone)
    pq.write_table(kept, folder / "synthetic-adt/scores.parquet")
    with pytest.raises(RunError, match=r"summary\.json, unsupported: expected 1"):
        checked(folder, None)
    fit_summary_to_scores(folder)
    with pytest.raises(RunError, match=rf"scores\.parquet, row 0: expected {gone}"):
        checked(folder, runs / "table")


def test_motions_from_elsewhere_are_refused(runs: Path) -> None:
    shutil.rmtree(runs / "scripted" / "synthetic-adt/predictions")
    shutil.copytree(
        runs / "ground-truth" / "synthetic-adt/predictions", runs / "scripted" / "synthetic-adt/predictions"
    )
    with pytest.raises(RunError, match=r"method\.name: expected scripted's motions, found others"):
        checked(runs / "scripted", runs / "table")


def test_a_finished_run_that_is_run_again_does_not_print_edited_results(runs: Path) -> None:
    again = RunRequest(method="scripted", data=(runs / "table",), out=runs / "scripted")
    assert run_method(again).batches_made == 0
    edit_summary(runs / "scripted", mean=1.0)
    with pytest.raises(RunError, match=r"summary\.json, prime_success\.mean"):
        run_method(again)
    edit_scores(runs / "scripted", lambda values: values + 1)
    with pytest.raises(RunError, match=r"scores\.parquet, row"):
        run_method(again)
    (runs / "scripted" / "synthetic-adt/scores.parquet").unlink()  # as the message says
    run_method(again)
    assert checked(runs / "scripted", runs / "table").unverified == ""


def test_without_motions_or_table_every_export_says_unverified(runs: Path, capsys) -> None:
    shutil.rmtree(runs / "scripted" / "synthetic-adt/predictions")
    folders = [str(runs / "scripted"), str(runs / "ground-truth")]
    told = {}
    for format in ("md", "csv", "json"):
        assert main(["leaderboard", "export", *folders, "--format", format, "--data", str(runs / "table")]) == 0
        told[format], warned = capsys.readouterr()
        assert "unverified: scripted: its folder holds no motions" in warned
    markdown = {line.split("|")[2].strip(): line for line in told["md"].splitlines() if line.startswith("|")}
    assert "| unverified |" in markdown["scripted"]
    assert "unverified" not in markdown["ground-truth"]
    assert "not held against the motions, because its folder holds no motions" in told["md"]
    (table,) = json.loads(told["json"])["tables"]
    assert {row["record"]["method"]["name"]: bool(row["unverified"]) for row in table["rows"]} == {
        "scripted": True,
        "ground-truth": False,
    }
    assert {line.split(",")[3]: ",unverified," in line for line in told["csv"].splitlines()[1:]} == {
        "scripted": True,
        "ground-truth": False,
    }


def test_a_comparison_refuses_forged_scores_and_says_what_is_unverified(runs: Path, capsys) -> None:
    compared = ["leaderboard", "compare", str(runs / "scripted"), str(runs / "ground-truth")]
    assert main(compared) == 0
    assert capsys.readouterr().out.count("unverified: ") == 2
    assert main([*compared, "--data", str(runs / "table")]) == 0
    assert "unverified" not in capsys.readouterr().out
    edit_scores(runs / "scripted", np.ones_like, "prime_success")
    assert main(compared) == RunError.exit_code
    assert "summary.json, prime_success." in capsys.readouterr().err


def test_a_view_shows_no_edited_scores(runs: Path, capsys) -> None:
    edit_scores(runs / "scripted", lambda values: values * 0)
    out = runs / "x.png"
    assert (
        main(["view", str(runs / "scripted"), "--data", str(runs / "table"), "--out", str(out)]) == RunError.exit_code
    )
    assert "summary.json, mpjpe." in capsys.readouterr().err
    assert not out.exists()
