"""``prbench audit``: a table of controls and metrics for people, the same as JSON, and run folders on request."""

from __future__ import annotations

from prbench.cli import main
from prbench.cli.audit import AuditReport
from prbench.metrics import METRICS
from prbench.runs import RunFolder
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


def test_the_report_holds_every_score_and_the_runs_are_kept_on_request(tmp_path, capsys):
    table = fake_dataset(tmp_path / "table", 24)
    out = tmp_path / "runs"
    words = ["audit", "--data", str(table.folder), "--limit", "6", "--out", str(out)]
    report = reported(words, AuditReport, capsys)
    (audited,) = report.tables
    assert set(audited.as_good_as_people) <= {info.id for info in METRICS if info.higher_is_better is not None}
    for control in audited.controls:
        folder = out / control.name.replace(", ", "-")
        assert RunFolder.open(folder).record.method.kind == "control"
        assert control.scores.sequences == 6
    recorded = [control.name for control in audited.controls if control.is_recorded]
    assert recorded == ["ground-truth, shuffled-goal", "ground-truth", "ground-truth-resampled", "ground-truth-30fps"]
