"""``prbench run --method all``: what it prints, what it refuses, and that a single run is asked for as ever."""

from __future__ import annotations

import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.harness.run_folder import RunFolder
from tests.fakes import fake_dataset


@pytest.fixture
def table(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    return fake_dataset(tmp_path / "table", 20)


def test_a_table_is_printed_in_the_studys_layout(table, tmp_path, capsys):
    words = ["run", "--method", "all", "--condition", "none", "--limit", "2", "--workers", "1"]
    assert main([*words, "--data", str(table.folder), "--out", str(tmp_path / "t")]) == 0
    printed = capsys.readouterr()
    assert "2 sequences, " in printed.out
    assert "No condition" in printed.out
    assert "Static" in printed.out
    assert "Prime Success ↑" in printed.out
    assert "ground-truth-resampled" in printed.out
    assert "Nothing is ranked: fewer than 50 sequences." in printed.out
    assert str(tmp_path / "t" / "table_2.md") in printed.out
    assert "synthetic-adt n = 2 of 5 (--limit 2)" in printed.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--method", "all", "--view", "x.png"], "--view: belongs to a run of one method"),
        (["--method", "all", "--sequence", "x"], "--sequence: belongs to a run of one method"),
        (["--method", "all", "--isolate"], "--isolate: belongs to a run of one method"),
        (["--method", "all", "--timeout", "9"], "--timeout: belongs to a run of one method"),
        (["--method", "all", "--permission", "adt"], "--permission: belongs to a run of one method"),
        (["--method", "all", "--seed", "-1"], "--seed: expected 0 or more, found -1"),
        (["--method", "cmd:python glide.py", "--condition", "all"], "Name one condition to run another method"),
        (["--method", "glide.toml", "--condition", "all"], "Name one condition to run another method"),
        (["--method", "ground-truth", "--condition", "all"], "Table 2 has no rows of 'ground-truth'"),
        (["--method", "all", "--option", "steps=3"], "expected METHOD.steps="),
        (["--method", "all", "--weights", "mdm-small"], "expected a folder of weights for a table, found no folder"),
        (["--method", "scripted", "--condition", "all"], "Table 2 has no rows of 'scripted'"),
        (["--method", "static", "--with-controls"], "--with-controls: belongs to --method all"),
        (["--method", "all", "--fold", "1/2"], "--fold: belongs to a run of one method"),
        (["--method", "all", "--folds", "participant"], "--fold: belongs to a run of one method"),
    ],
)
def test_what_does_not_fit_together_is_refused(words, message, table, tmp_path, capsys):
    assert main(["run", *words, "--data", str(table.folder), "--out", str(tmp_path / "t")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "t").exists()


@pytest.mark.slow
def test_what_suits_a_table_reaches_its_rows(table, tmp_path, capsys):
    words = ["--method", "static", "--condition", "all", "--split", "train", "--limit", "3", "--seed", "5"]
    words += ["--samples", "2", "--batch-size", "2", "--threads", "2", "--workers", "2"]
    assert main(["run", *words, "--data", str(table.folder), "--out", str(tmp_path / "t")]) == 0
    record = RunFolder.open(tmp_path / "t/rows/none-static-mean-training-pose").record
    assert (record.split, record.limit, record.seed, record.samples, record.threads) == ("train", 3, 5, 2, 2)
    assert (record.tables[0].batch_plan.batch_size, record.tables[0].batch_plan.batches) == (2, 2)
    printed = capsys.readouterr()
    assert "Static" in printed.out
    assert "MDM" not in printed.out
    assert "\x1b" not in printed.out + printed.err  # no colours in a file


def test_a_run_of_one_method_has_no_condition_unless_told(table, tmp_path):
    assert main(["run", "--method", "static", "--data", str(table.folder), "--out", str(tmp_path / "one")]) == 0
    assert RunFolder.open(tmp_path / "one").record.condition == Condition.NONE
