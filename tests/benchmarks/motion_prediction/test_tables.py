from __future__ import annotations

import json

import pytest

from prbench.errors import RunError, UsageError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.table import WindowsTable
from prbench_benchmarks.motion_prediction.tables import TablesRequest, run_tables
from prbench_benchmarks.motion_prediction.tables.from_runs import scores_of_runs
from prbench_benchmarks.motion_prediction.tables.gaze_value import lead_of, values_of_conditions
from prbench_benchmarks.motion_prediction.tables.run import JSON, MARKDOWN
from tests.benchmarks.motion_prediction.windows import walking, write


@pytest.fixture(scope="module")
def windows(tmp_path_factory):
    runs = [walking(f"r{n}", 110, number=n, split="train" if n > 1 else "test") for n in range(4)]
    return write(tmp_path_factory.mktemp("windows") / "w", *runs)


@pytest.fixture(scope="module")
def report(windows, tmp_path_factory):
    return run_tables(TablesRequest(windows=windows, out=tmp_path_factory.mktemp("tables") / "out", samples=3))


def test_rows_without_learning_stand_beside_the_printed_numbers(report):
    lines = {line.row.name: line for line in report.layout.tables[0].lines}
    assert lines["ground-truth-pose"].measured["ade"].mean == pytest.approx(0.0, abs=1e-4)
    assert lines["zero-velocity-pose"].measured["ade"].mean > lines["nearest-past-pose"].measured["ade"].mean
    assert lines["gazemodiff-pose-gaze"].published["mogaze"]["ade"].printed == "0.638"
    assert lines["zero-velocity-pose"].published == {}
    text = (report.folder / MARKDOWN).read_text()
    assert "| HumanMAC |" in text
    assert "are not to be compared" in text


def test_rows_that_cannot_be_run_say_why(report):
    missing = {line.row.name: line.missing for table in report.layout.tables for line in table.lines}
    assert "weights 'no-cross-attention'" in missing["no-cross-attention-pose-gaze"]
    assert missing["zero-velocity-pose"] == ""


def test_methods_are_ordered_and_references_are_not(report):
    order = report.layout.tables[0].order
    assert {order[0].better, *(step.worse for step in order)} == {
        "nearest past",
        "nearest past, head",
        "zero velocity",
        "constant velocity",
        "CVAE",
        "BeLFusion",
        "HumanMAC",
        "GazeMoDiff, no gaze",
        "GazeMoDiff, head",
        "GazeMoDiff",
    }  # DLow answers with fifty futures only
    assert all(step.comparison.difference.mean >= 0 for step in order)


def test_the_value_of_gaze_is_paired_between_all_conditions(report):
    told = {(each.less.value, each.more.value) for each in report.values if each.method == "nearest-past"}
    assert told == {("pose", "pose+head"), ("pose", "pose+gaze"), ("pose+head", "pose+gaze")}
    assert {each.metric for each in report.values} == {"ade", "fde", "ade_mean"}  # windows that slide have no goal


def test_the_same_command_takes_scores_over_and_writes_equal_bytes(windows, report):
    before = (report.folder / JSON).read_bytes()
    again = run_tables(TablesRequest(windows=windows, out=report.folder, samples=3))
    assert again.scored == ()
    assert (report.folder / JSON).read_bytes() == before
    json.loads(before)


def test_everybody_is_scored_once_when_participants_are_left_out(windows, report):
    request = TablesRequest(windows=windows, out=report.folder, samples=2, split="participants", limit=4)
    left_out = run_tables(request)
    assert left_out.layout.n_participants == 4
    assert left_out.layout.n_windows == 4
    assert len(left_out.scored) == len(report.scored)  # other settings: nothing is taken over


@pytest.mark.parametrize(("wrong", "message"), [({"samples": 0}, "--samples"), ({"limit": 0}, "--limit")])
def test_nothing_is_refused(wrong, message, tmp_path):
    with pytest.raises(UsageError, match=message):
        TablesRequest(windows=tmp_path, out=tmp_path / "out", **wrong)


def test_a_lead_is_read_from_the_anchor():
    assert lead_of("event-1.5") == 1.5
    assert lead_of("prime") is None
    assert lead_of("sliding") is None


def test_one_condition_has_no_value():
    assert values_of_conditions({"a": {Condition.POSE: None}}) == ()  # type: ignore[dict-item]


def test_finished_runs_stand_for_their_rows(windows, tmp_path):
    out = tmp_path / "runs" / "constant"
    asked = {"benchmark": "motion-prediction", "condition": "pose", "samples": 1, "limit": 2}
    run_method(RunRequest(method="constant-velocity", data=(windows,), out=out, **asked))  # type: ignore[arg-type]
    scores = scores_of_runs([tmp_path / "runs"], WindowsTable.open(windows))
    report = run_tables(TablesRequest(windows=windows, out=tmp_path / "out", samples=2, runs=(out,)))
    assert report.layout.n_windows == 2
    assert "constant-velocity-pose" not in report.scored
    lines = {line.row.name: line for line in report.layout.tables[0].lines}
    found = lines["constant-velocity-pose"].measured["ade"].mean
    assert found == scores["constant-velocity-pose"].means()["ade"]
    # The run's windows are those of the other rows, too: paired differences would refuse others.
    assert {step.worse for step in report.layout.tables[0].order} | {report.layout.tables[0].order[0].better} >= {
        "constant velocity",
        "zero velocity",
    }


def test_no_runs_and_runs_with_a_split_are_refused(windows, tmp_path):
    with pytest.raises(RunError, match="found none"):
        scores_of_runs([tmp_path], WindowsTable.open(windows))
    with pytest.raises(UsageError, match="leave --split"):
        TablesRequest(windows=windows, out=tmp_path, runs=(tmp_path,), split="dataset")
