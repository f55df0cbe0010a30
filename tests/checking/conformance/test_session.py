"""Whatever a method does, the report comes to an end; and what only another process shows is seen."""

from __future__ import annotations

import json
import re
import sys

import pytest

from prbench.checking.conformance import CheckRequest, Finding, Outcome, Report, check
from prbench.checking.conformance.checks import CHECKS
from prbench.cli import main
from prbench.cli.adapters import print_report
from prbench.errors import AdapterError, UsageError
from tests.cli.reports import documented, refused, reported


def outcomes(report):
    return {finding.check: finding.outcome for finding in report.findings}


def test_a_method_that_ends_its_process_fails_and_is_not_asked_again(site, data):
    report = check(CheckRequest("dies", data=data))
    (failed,) = report.failed
    assert failed.check == "generates"
    assert "ended with exit status 7" in failed.said
    assert "while it generated 2 sequences" in failed.said
    assert "about to die" in failed.said
    assert outcomes(report)["determinism"] is Outcome.SKIPPED
    assert list(outcomes(report)) == [one.name for one in CHECKS]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals end processes elsewhere only")
def test_after_a_crash_and_a_hang_the_other_checks_go_on(site, data):
    report = check(CheckRequest("diesonblanktextandhangsonthelongest", data=data, time_limit=3.0))
    hung, crashed = report.failed
    assert hung.check == "lengths"
    assert "no end after 3 s, while it generated 2 sequences of up to 241 frames" in hung.said
    assert crashed.check == "text"
    assert "signal 11" in crashed.said
    assert outcomes(report)["memory"] is Outcome.PASSED
    assert outcomes(report)["process"] is Outcome.PASSED


def test_a_control_is_no_method():
    with pytest.raises(UsageError, match="control of the harness"):
        check(CheckRequest("ground-truth"))


def test_an_unknown_method_is_the_users_error(site, data):
    with pytest.raises(AdapterError, match="Did you mean 'glide'"):
        check(CheckRequest("glied"))


def test_the_command_prints_what_to_change_and_exits_with_5(site, data, capsys, tmp_path):
    options = ["--data", str(data), "--out", str(tmp_path / "report.json")]
    assert main(["adapters", "check", "hashoftext", *options]) == 5
    lines = capsys.readouterr().out.splitlines()
    (failed,) = [line for line in lines if line.startswith("failed")]
    assert "process" in failed
    assert "Python's hash() of text" in failed
    assert lines[-2].startswith("hashoftext does not keep the contract: ")
    assert lines[-1] == f"report: {tmp_path / 'report.json'}"
    document = json.loads((tmp_path / "report.json").read_text())
    assert document["exit_code"] == 5
    report = documented(document["report"], Report)
    assert [finding.outcome for finding in report.findings].count("failed") == 1
    assert {finding.check for finding in report.findings} == {one.name for one in CHECKS}


def test_the_command_reports_a_sound_method_and_an_unknown_one_as_json(site, data, capsys):
    report = reported(["adapters", "check", "glide", "--data", str(data)], capsys)
    assert {finding.outcome for finding in report.findings} <= {"passed", "skipped", "warning"}
    refused(["adapters", "check", "glied"], capsys, code=5, message="Did you mean 'glide'?")


def test_each_finding_is_a_line_with_what_to_change(capsys):
    findings = (
        Finding("load", Outcome.PASSED, "takes [text]."),
        Finding("text", Outcome.FAILED, "no words.", "Treat it as no text."),
    )
    print_report(Report("glide", findings, 1.0))
    shown = capsys.readouterr().out
    assert "takes [text]." in shown  # brackets are no markup
    assert re.search(r"failed\s+text\s+no words\. Treat it as no text\.", shown)
    assert "1 passed, 0 skipped, 0 warning, 1 failed" in shown


def test_an_import_that_never_ends_has_a_limit_of_its_own(site, data):
    request = CheckRequest("neverimported", data=data, start_limit=2.0)
    report = check(request)
    (failed,) = report.failed
    assert failed.check == "import"
    assert "no end after 2 s, while importing prbench_methods_under_test_neverimported" in failed.said
    assert "--start-timeout" in failed.remedy
    assert report.seconds < 60


def test_findings_come_in_the_order_in_which_they_are_announced(site, data):
    announced = []
    report = check(CheckRequest("glide", data=data), lambda name, _place, _total: announced.append(name))
    assert list(outcomes(report)) == announced
    assert announced[-1] == "process"


def test_checks_that_wait_for_another_one_share_a_line_and_a_log_keeps_its_own(capsys):
    waiting = [Finding(name, Outcome.SKIPPED, "not looked at before 'load' passes.") for name in ("shapes", "memory")]
    load = Finding("load", Outcome.FAILED, "it ended. The log:\n    line one", "Repair it.")
    imports = Finding("import", Outcome.SKIPPED, "a program imports nothing.")
    print_report(Report("glide", (imports, load, *waiting), 1.0))
    assert capsys.readouterr().out.splitlines() == [
        "skipped  import           a program imports nothing.",
        "failed   load             it ended. The log:",
        "    line one",
        "    Repair it.",
        "skipped  not looked at before 'load' passes. 2: shapes, memory.",
        "glide does not keep the contract: 0 passed, 3 skipped, 0 warning, 1 failed; 1.0 s.",
    ]
