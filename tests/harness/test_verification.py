"""Edited results contradict their motions or their scores, and whoever reads the run says so."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.errors import RunError
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker, summary_of
from prbench.harness.run import run_method
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.scores import read_scores
from prbench.sequences import SequenceTable
from prbench.sequences.sequence import recording_key
from tests.fakes import fake_dataset


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
    assert main(["score", str(runs / "scripted"), "--data", str(runs / "table"), "--out", str(out)]) == 0
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
    with pytest.raises(RunError, match=r"mpjpe, recorded_motion from the motions and their table, found"):
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
