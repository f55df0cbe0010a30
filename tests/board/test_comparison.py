"""Two runs are compared on the same sequences, recording by recording, or not at all."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.compute as pc
import pytest

import prbench
from prbench.board import collect_runs, compare_runs
from prbench.board.comparison import separate_by_comparison
from prbench.board.tables import undecided
from prbench.cli import main
from prbench.errors import RunError
from prbench.harness.intervals import clustered
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import DatasetSummary, read_scores
from prbench.harness.run_folder.folder import RunFolder
from prbench.metrics import MAIN_METRICS, METRICS
from prbench.sequences.sequence import recording_key
from tests.cli.reports import plain, refused, reported
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Runs of two controls on one table, of one on another table, and of one on fewer sequences."""
    root = tmp_path_factory.mktemp("comparison")
    table = fake_dataset(root / "table", 64, recordings=36).folder
    other = fake_dataset(root / "other", 60, recordings=32).folder
    for name, method, data, limit in (
        ("truth", "ground-truth", table, None),
        ("scripted", "scripted", table, None),
        ("few", "ground-truth", table, 5),
        ("elsewhere", "ground-truth", other, None),
    ):
        run_method(RunRequest(method=method, data=(data,), limit=limit, out=root / name))
    return root


def test_the_difference_is_that_of_the_means_and_has_a_sign(folder):
    rows = {row.info.id: row.comparison for row in compare_runs(folder / "truth", folder / "scripted").metrics}
    back = {row.info.id: row.comparison for row in compare_runs(folder / "scripted", folder / "truth").metrics}
    assert set(rows) == {info.id for info in MAIN_METRICS if info.compared}
    assert rows["mpjpe"].difference.mean < 0, "the recorded motion has no error"
    assert rows["mpjpe"].conclusion == "lower"
    assert rows["mpjpe"].difference.n_recordings == 9, "recordings are the units"
    for metric, comparison in rows.items():
        assert comparison.difference.mean == pytest.approx(-back[metric].difference.mean)
        assert comparison.adjusted_p_value == pytest.approx(back[metric].adjusted_p_value)


def test_a_summary_states_its_detectable_difference_for_as_many_metrics_as_are_compared(folder):
    compared = compare_runs(folder / "truth", folder / "scripted").metrics
    run = RunFolder.open(folder / "scripted").dataset("synthetic-adt")
    stored = DatasetSummary.read(run.path).metric("mpjpe")
    rows = read_scores(run.scores).filter(pc.field("metric") == "mpjpe")
    ids = rows["sequence_id"].to_pylist()
    values = rows["value"].to_numpy()
    twice = np.sqrt(2) * values  # as the difference to an unrelated method of the same spread
    expected = clustered(twice, list(map(recording_key, ids)), ids).detectable(len(compared))
    assert expected is not None
    assert stored.detectable == pytest.approx(expected)
    count = sum(info.compared for info in MAIN_METRICS)
    assert len(compared) == count
    assert any(
        f"correction for {count} metrics" in line
        for line in undecided("a", "test", 64, 36, [[stored]], metrics=[row.info for row in compared])
    )


def test_only_supported_differences_separate_the_rows_of_a_board(folder):
    rows = collect_runs([folder / "truth", folder / "scripted"]).rows
    truth = next(i for i, row in enumerate(rows) if row.method == "ground-truth")
    beaten = separate_by_comparison(rows, [info for info in METRICS if info.main])
    assert beaten[1 - truth, "mpjpe"] == {truth}
    supported = {
        row.info.id
        for row in compare_runs(folder / "truth", folder / "scripted").metrics
        if row.comparison.conclusion in ("higher", "lower")
    }
    assert {metric for _, metric in beaten} == supported
    assert separate_by_comparison(rows[:1], METRICS) == {}
    same = separate_by_comparison([rows[0], rows[0]], METRICS)
    assert same == {}


def test_a_run_does_not_differ_from_itself(folder):
    for row in compare_runs(folder / "scripted", folder / "scripted").metrics:
        assert row.comparison.difference.mean == 0
        assert row.comparison.conclusion == "not supported by the data"


def test_other_sequences_and_other_tables_are_refused(folder):
    with pytest.raises(RunError, match=r"different sequences of synthetic-adt \(16 and 5\)"):
        compare_runs(folder / "truth", folder / "few")
    with pytest.raises(RunError, match="different tables of synthetic-adt"):
        compare_runs(folder / "truth", folder / "elsewhere")


def test_the_command_prints_a_conclusion_and_no_certainty(folder, capsys):
    assert main(["leaderboard", "compare", str(folder / "truth"), str(folder / "scripted")]) == 0
    printed = capsys.readouterr().out
    assert "truth is lower" in printed
    assert "nan" not in printed
    assert main(["leaderboard", "compare", str(folder / "truth"), str(folder / "truth")]) == 0
    assert "all equal" in capsys.readouterr().out


def test_too_few_recordings_cannot_be_tested_and_what_is_needed_is_said(tmp_path, capsys):
    table = fake_dataset(tmp_path / "table", 12, recordings=12).folder
    for method in ("ground-truth", "scripted"):
        run_method(RunRequest(method=method, data=(table,), out=tmp_path / method))
    folders = [tmp_path / "ground-truth", tmp_path / "scripted"]
    compared = compare_runs(*folders).metrics
    assert compared[0].comparison.difference.n_recordings < 9
    assert {row.conclusion for row in compared} == {"cannot be tested"}
    assert main(["leaderboard", "compare", *map(str, folders)]) == 0
    printed = capsys.readouterr().out
    assert "cannot be tested: 9 recordings (of folds: participants) or more are needed" in printed
    said = prbench.compare(*folders).summary
    assert "(cannot be tested)" in said
    assert "is cannot" not in said + printed
    assert separate_by_comparison(collect_runs(folders).rows, MAIN_METRICS) == {}


def test_the_command_reports_the_comparison_as_json(folder, capsys):
    words = ["leaderboard", "compare", str(folder / "truth"), str(folder / "scripted")]
    report = reported(words, capsys)
    rows = {row.info.id: row.comparison for row in compare_runs(folder / "truth", folder / "scripted").metrics}
    assert {each.info.id: each.comparison.difference.mean for each in report.metrics} == {
        name: comparison.difference.mean for name, comparison in rows.items()
    }
    assert (report.first.method, report.second.method) == ("ground-truth", "scripted")
    assert len(report.unverified) == 2, "the tables were not named"
    refused([*words[:-1], str(folder / "few")], capsys, code=RunError.exit_code, message="different sequences")


def test_the_board_is_reported_as_json_in_every_format(folder, tmp_path, capsys):
    runs = [str(folder / "truth"), str(folder / "scripted")]
    report = reported(["leaderboard", "export", *runs], capsys)
    assert [row.record.method.name for row in report.tables[0].rows] == ["ground-truth", "scripted"]
    out = tmp_path / "board.csv"
    assert reported(["leaderboard", "export", *runs, "--format", "csv", "--out", str(out)], capsys) == report
    assert out.read_text().startswith("table,dataset,condition,method")
    assert main(["leaderboard", "export", *runs, "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out) == plain(report)
    refused(["leaderboard", "export", str(tmp_path)], capsys, code=RunError.exit_code, message="found none")


def test_recordings_are_taken_from_the_end_of_the_id():
    assert recording_key("adt/tour/M1292/123/pick/5/suit") == "adt/tour/M1292"
