"""``prbench diff`` as a program reads it."""

from __future__ import annotations

import json

from prbench.cli import main
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


def test_equal_builds_are_reported_as_equal(tmp_path, capsys):
    folder = str(fake_dataset(tmp_path / "table", 4).folder)
    report = reported(["diff", folder, folder], capsys)
    assert (report.changes, report.unchanged_events) == ([], 4)


def test_changes_are_reported_as_json_and_end_with_one(tmp_path, capsys):
    first = str(fake_dataset(tmp_path / "first", 6).folder)
    second = str(fake_dataset(tmp_path / "second", 4).folder)
    assert reported(["diff", first, second], capsys, code=1).changes


def test_the_report_is_written_where_it_is_asked_for(tmp_path, capsys):
    folder = str(fake_dataset(tmp_path / "table", 4).folder)
    out = tmp_path / "report.json"
    assert main(["diff", folder, folder, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "unchanged: 4 events" in printed
    assert f"report: {out}" in printed
    assert json.loads(out.read_text())["report"]["changes"] == []


def test_a_folder_without_a_table_is_an_error_in_the_document(tmp_path, capsys):
    folder = str(fake_dataset(tmp_path / "table", 4).folder)
    refused(["diff", folder, str(tmp_path / "gone")], capsys, code=4, message="gone")
