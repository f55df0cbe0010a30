"""``prbench audit``: a table of controls and metrics for people, the same as JSON, and run folders on request."""

from __future__ import annotations

import pytest

from prbench.board import audit as workflow
from prbench.cli import main
from prbench.harness.run_folder import RunFolder
from tests.cli.reports import reported
from tests.fakes import fake_dataset


def test_every_control_is_printed_under_every_metric(tmp_path, capsys):
    table = fake_dataset(tmp_path / "table", 24)
    assert main(["audit", "--data", str(table.folder), "--limit", "6"]) == 0
    shown = capsys.readouterr().out
    for name in ("stare", "stare-late", "tremor", "teleport", "float", "scripted", "nearest-neighbour"):
        assert f"\n {name} " in shown
    for word in ("Skating", "Success", "gaze)", "shuffled-goal", "ground-truth-30fps"):
        assert word in shown
    assert "Reach Success: no worse than recorded people: scripted, teleport, float" in shown
    assert "never compare them with published ones" in shown


@pytest.mark.slow
def test_of_several_tables_means_stand_first_and_each_table_follows_with_v(tmp_path, capsys, monkeypatch):
    folders = []
    for name in ("adt", "gimo"):
        folders.append(str(fake_dataset(tmp_path / name, 12, dataset=name).folder))
    words = ["audit", "--limit", "3", "--data", *folders]
    # The same runs are shown three times.
    monkeypatch.setattr(workflow, "audit", cache_of_one_call(workflow.audit))
    report = reported(words, capsys)
    assert len(report) == 2
    means = workflow.means_of_controls(workflow.audit())
    for control, *on_each in zip(means, *(table.controls for table in report), strict=True):
        assert {each.name for each in on_each} == {control.name}
        rates = [
            next(metric.mean for metric in each.summary.metrics if metric.metric == "reach_success") for each in on_each
        ]
        assert control.means["reach_success"].mean == sum(rates) / 2
    assert main(words) == 0
    short = capsys.readouterr().out
    assert short.startswith("Means over 2 datasets, 3 sequences of each, split test; the main metrics")
    assert short.count("\n teleport ") == 1
    assert main([*words, "-v"]) == 0
    assert capsys.readouterr().out.count("\n teleport ") > 6


def cache_of_one_call(function):
    """Return the function's first answer whenever it is called."""
    answers = []

    def answer(*arguments, **options):
        if not answers:
            answers.append(function(*arguments, **options))
        return answers[0]

    return answer


def test_the_report_holds_every_score_and_the_runs_are_kept_on_request(tmp_path, capsys):
    table = fake_dataset(tmp_path / "table", 24)
    out = tmp_path / "runs"
    words = ["audit", "--data", str(table.folder), "--limit", "6", "--out", str(out)]
    (audited,) = reported(words, capsys)
    for control in audited.controls:
        folder = out / control.name.replace(", ", "-")
        assert RunFolder.open(folder).record.method.kind == "control"
        assert control.summary.sequences == 6
    recorded = [control.name for control in audited.controls if control.is_recorded]
    assert recorded == ["ground-truth, shuffled-goal", "ground-truth", "ground-truth-resampled", "ground-truth-30fps"]
