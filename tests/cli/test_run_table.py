"""``prbench run --method all``: what it prints, what it refuses, and that a single run is asked for as ever."""

from __future__ import annotations

import re

import pytest

from prbench.cli import main
from prbench.cli.main import _parser
from prbench.contract import Condition
from prbench.runs import RunFolder
from tests.fakes import fake_dataset


@pytest.fixture
def table(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    return fake_dataset(tmp_path / "table", 20)


def test_a_table_is_printed_in_the_studys_layout(table, tmp_path, capsys):
    words = ["run", "--method", "all", "--condition", "none", "--limit", "2", "--workers", "1"]
    assert main([*words, "--data", str(table.folder), "--out", str(tmp_path / "t")]) == 0
    printed = capsys.readouterr()
    header = next(line for line in printed.out.splitlines() if "Method" in line)
    titles = ["Condition", "Method", "Prime Success ↑", "Reach Success ↑", "Goal MPJPE ↓", "Loc Err ↓", "MPJPE ↓"]
    titles += ["Foot Skating ↓", "s/motion", "passes/motion", "MiB"]
    assert re.split(r"\s{2,}", header.strip()) == titles
    assert "n = 2 sequences of" in printed.out
    assert "No condition   Static" in printed.out
    assert "ground-truth-resampled" in printed.out
    assert "Nothing is ranked on synthetic-adt: fewer than 50 sequences." in printed.out
    assert str(tmp_path / "t" / "table_2.md") in printed.out
    assert "synthetic-adt n = 2 of 5 (--limit 2)" in printed.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--method", "all", "--view", "x.png"], "--view: belongs to a run of one method"),
        (["--method", "all", "--sequence", "x"], "--sequence: belongs to a run of one method"),
        (["--method", "all", "--isolate"], "--isolate: belongs to a run of one method"),
        (["--method", "all", "--option", "steps=3"], "expected METHOD.steps="),
        (["--method", "all", "--weights", "mdm-small"], "expected a folder of weights for a table, found no folder"),
        (["--method", "scripted", "--condition", "all"], "Table 2 has no rows of 'scripted'"),
        (["--method", "static", "--minutes", "3"], "--minutes: belongs to --method all"),
    ],
)
def test_what_does_not_fit_together_is_refused(words, message, table, tmp_path, capsys):
    assert main(["run", *words, "--data", str(table.folder), "--out", str(tmp_path / "t")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "t").exists()


def test_a_run_of_one_method_has_no_condition_unless_told(table, tmp_path):
    assert _parser().parse_args(["run", "--method", "static"]).method == "static"
    assert main(["run", "--method", "static", "--data", str(table.folder), "--out", str(tmp_path / "one")]) == 0
    assert RunFolder.open(tmp_path / "one").record.condition == Condition.NONE
