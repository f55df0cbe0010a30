"""``prbench synthesize --table``: training data without native files."""

from __future__ import annotations

from prbench.cli import main
from prbench.sequences import SequenceTable


def test_a_table_is_written_without_native_files(tmp_path, capsys):
    out = tmp_path / "table"
    assert main(["synthesize", "gimo", "--table", "--count", "1", "--events", "3", "--out", str(out)]) == 0
    info = SequenceTable.open(out).info
    assert info.dataset == "synthetic-gimo"
    assert info.counts.recordings_read == 1
    assert f"{info.counts.sequences} sequences of 1 recordings" in capsys.readouterr().out


def test_size_large_casts_from_the_large_world(tmp_path):
    out = tmp_path / "table"
    small = ["--count", "1", "--events", "3", "--out", str(out)]
    assert main(["synthesize", "gimo", "--table", "--size", "large", *small]) == 0
    assert SequenceTable.open(out).info.options["synthetic_world"] == "large"


def test_native_files_of_size_large_are_refused_and_the_way_out_named(tmp_path, capsys):
    assert main(["synthesize", "gimo", "--size", "large", "--out", str(tmp_path / "tree")]) == 2
    assert "--table" in capsys.readouterr().err
    assert not (tmp_path / "tree").exists()


def test_what_damages_files_does_not_go_with_a_table(tmp_path, capsys):
    assert main(["synthesize", "gimo", "--table", "--defect", "any", "--out", str(tmp_path / "table")]) == 2
    assert "--defect" in capsys.readouterr().err
