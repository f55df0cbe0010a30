"""``prbench synthesize``: native files, or a table without them."""

from __future__ import annotations

import pytest

from prbench.cli import main
from prbench.sequences import SequenceTable
from tests.cli.reports import refused, reported

FEW = ["--count", "1", "--events", "3"]


def test_files_are_reported(tmp_path, capsys) -> None:
    report = reported(["synthesize", "gimo", *FEW, "--out", str(tmp_path / "gimo")], capsys)
    assert report.folder == tmp_path / "gimo"
    (recording,) = report.recordings
    assert recording.n_events
    assert recording.n_objects
    words = ["synthesize", "nymeria", "--count", "1", "--out", str(tmp_path / "nymeria")]
    assert [each.n_objects for each in reported(words, capsys).recordings] == [0]


@pytest.mark.unchecked_shapes
def test_a_table_is_written_without_native_files_and_reported(tmp_path, capsys) -> None:
    out = tmp_path / "table"
    words = ["synthesize", "gimo", "--table", *FEW, "--out", str(out)]
    report = reported(words, capsys)
    assert (report.folder, report.recordings) == (out, [])
    info = SequenceTable.open(out).info
    assert report.built[str(out)]["dataset"] == info.dataset == "synthetic-gimo"
    assert report.built[str(out)]["counts"]["recordings_read"] == info.counts.recordings_read == 1
    assert main([*words, "--size", "large", "--replace"]) == 0
    info = SequenceTable.open(out).info
    assert f"{info.counts.sequences} sequences of 1 recordings" in capsys.readouterr().out
    assert info.options["synthetic_world"] == "large"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--out DIR is needed"),
        (["--recordings", "1", "--out", "x"], "No such option '--recordings'. Did you mean '--count'?"),
        (["--size", "large", "--out", "x"], "--table"),
        (["--table", "--egoallo", "--out", "x"], "--egoallo"),
        (["--world", "second", "--out", "x"], "add --table"),
        (["--world", "second", "--table", "--size", "large", "--out", "x"], "leave --size large out"),
        (["--world", "third", "--out", "x"], "'third' is not one of 'default', 'second'"),
    ],
)
def test_mistakes_are_refused_and_the_way_out_named(words, message, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    refused(["synthesize", "gimo", *words], capsys, code=2, message=message)
    assert list(tmp_path.iterdir()) == []
