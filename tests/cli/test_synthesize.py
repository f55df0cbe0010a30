"""``prbench synthesize`` as a program reads it."""

from __future__ import annotations

import pytest

from prbench.cli import main
from tests.cli.reports import refused, reported


@pytest.mark.unchecked_shapes
def test_files_are_reported_with_what_curation_finds_in_them(tmp_path, capsys) -> None:
    words = ["synthesize", "adt", "--count", "1", "--events", "3", "--seed", "2", "--out", str(tmp_path / "adt")]
    report = reported(words, capsys)
    assert report.folder == tmp_path / "adt"
    (recording,) = report.recordings
    assert recording.n_events == 3
    assert recording.n_objects
    assert report.check.recordings == 1
    assert 1 <= report.check.true_events <= 3, "events within the sensors' resolution of a threshold are not counted"
    assert report.table is None


def test_unverified_files_and_text_motion_are_reported_without_checks(tmp_path, capsys) -> None:
    words = ["synthesize", "gimo", "--count", "1", "--events", "2", "--no-verify", "--out", str(tmp_path / "gimo")]
    assert reported(words, capsys).check is None
    words = ["synthesize", "nymeria", "--count", "1", "--out", str(tmp_path / "nymeria")]
    report = reported(words, capsys)
    assert [each.n_objects for each in report.recordings] == [0]
    assert report.check is None


@pytest.mark.unchecked_shapes
def test_a_table_is_reported(tmp_path, capsys) -> None:
    out = tmp_path / "table"
    words = ["synthesize", "gimo", "--table", "--count", "1", "--events", "3", "--out", str(out)]
    report = reported(words, capsys)
    assert report.table is not None
    assert (report.table.dataset, report.table.folder) == ("synthetic-gimo", out)
    assert report.table.counts["recordings_read"] == len(report.table.recordings) == 1
    assert (report.folder, report.recordings) == (None, [])


def test_the_number_of_recordings_is_called_count(tmp_path, capsys) -> None:
    words = ["synthesize", "adt", "--recordings", "1", "--out", str(tmp_path / "adt")]
    assert main(words) == 2
    assert "No such option '--recordings'" in capsys.readouterr().err
    refused(["synthesize", "adt"], capsys, code=2, message="--out DIR is needed")
    assert list(tmp_path.iterdir()) == []
