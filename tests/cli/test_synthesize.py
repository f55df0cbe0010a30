"""``prbench synthesize`` as a program reads it."""

from __future__ import annotations

import pytest

from prbench.cli import main
from tests.cli.reports import refused, reported


def test_files_are_reported(tmp_path, capsys) -> None:
    words = ["synthesize", "gimo", "--count", "1", "--events", "3", "--out", str(tmp_path / "gimo")]
    report = reported(words, capsys)
    assert report.folder == tmp_path / "gimo"
    (recording,) = report.recordings
    assert recording.n_events
    assert recording.n_objects
    words = ["synthesize", "nymeria", "--count", "1", "--out", str(tmp_path / "nymeria")]
    assert [each.n_objects for each in reported(words, capsys).recordings] == [0]


@pytest.mark.unchecked_shapes
def test_a_table_is_reported(tmp_path, capsys) -> None:
    out = tmp_path / "table"
    words = ["synthesize", "gimo", "--table", "--count", "1", "--events", "3", "--out", str(out)]
    report = reported(words, capsys)
    assert (report.folder, report.recordings) == (out, [])
    assert report.built[str(out)]["dataset"] == "synthetic-gimo"
    assert report.built[str(out)]["counts"]["recordings_read"] == 1


def test_the_number_of_recordings_is_called_count(tmp_path, capsys) -> None:
    words = ["synthesize", "adt", "--recordings", "1", "--out", str(tmp_path / "adt")]
    assert main(words) == 2
    assert "No such option '--recordings'" in capsys.readouterr().err
    refused(["synthesize", "adt"], capsys, code=2, message="--out DIR is needed")
    assert list(tmp_path.iterdir()) == []
