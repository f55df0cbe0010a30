"""Folds of participants share nobody, cover everybody, and merge into one score."""

from __future__ import annotations

import pytest

from prbench.cli.leaderboard import MergeReport
from prbench.cli.split_dataset import SplitReport
from prbench.errors import RunError, TableError, UsageError
from prbench.evaluation.request import RunRequest
from prbench.evaluation.run import run_method
from prbench.leaderboard.merging import merge_folds
from prbench.sequences import SequenceTable
from prbench.sequences.folds import participant_folds, write_fold
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("table") / "data", 48)


@pytest.fixture(scope="module")
def folds(table, tmp_path_factory):
    root = tmp_path_factory.mktemp("folds")
    for fold in (1, 2, 3):
        write_fold(table, root / str(fold), fold=fold, folds=3)
    return [SequenceTable.open(root / str(fold)) for fold in (1, 2, 3)]


def _tested(table, column):
    rows = table.scalars(split="test")
    return set(rows[column].to_pylist())


def test_every_sequence_is_tested_once_and_nobody_is_learnt_from_and_tested_on(table, folds):
    ids = [_tested(fold, "sequence_id") for fold in folds]
    assert sum(map(len, ids)) == len(set.union(*ids)) == table.scalars().num_rows
    for fold in folds:
        learnt = set(fold.scalars(split="train")["participant_id"].to_pylist())
        learnt |= set(fold.scalars(split="validation")["participant_id"].to_pylist())
        assert not learnt & _tested(fold, "participant_id")
        assert fold.identity != table.identity, "a run on one is never taken for a run on another"
        assert fold.info.content_digest != table.info.content_digest
        assert fold.content == fold.info.content_digest
    assert [fold.info.options["participant_fold"] for fold in folds] == ["1/3", "2/3", "3/3"]


def test_folds_have_about_as_many_sequences(table):
    fold_of = participant_folds(table, 2)
    people = table.scalars()["participant_id"].to_pylist()
    counts = [sum(fold_of[name] == fold for name in people) for fold in (1, 2)]
    assert abs(counts[0] - counts[1]) <= max(people.count(name) for name in set(people))


def test_what_cannot_be_split_is_refused(table, folds, tmp_path):
    with pytest.raises(TableError, match="expected at least 9 participants"):
        participant_folds(table, 9)
    with pytest.raises(UsageError, match="is fold 1/3 already"):
        write_fold(folds[0], tmp_path / "again", fold=1, folds=3)
    with pytest.raises(UsageError, match="expected k/n"):
        write_fold(table, tmp_path / "again", fold=4, folds=3)


def test_merged_folds_are_the_scores_of_all_sequences(table, folds, tmp_path, capsys):
    paths = []
    for number, fold in enumerate(folds):
        paths.append(tmp_path / f"run-{number}")
        run_method(RunRequest(method="scripted", data=(fold.folder,), out=paths[-1]))
    merged, _ = merge_folds(paths)
    assert merged.sequences == table.scalars().num_rows
    assert merged.split == "3 folds"
    words = ["leaderboard", "merge", *map(str, paths)]
    report = reported(words, MergeReport, capsys)
    assert report.scores.sequences == merged.sequences
    with pytest.raises(RunError, match="folds share no sequence"):
        merge_folds([paths[0], paths[0]])
    with pytest.raises(RunError, match="expected a run of each fold"):
        merge_folds(paths[:1])
    other = tmp_path / "other"
    run_method(RunRequest(method="ground-truth", data=(folds[1].folder,), out=other))
    with pytest.raises(RunError, match="expected method scripted"):
        merge_folds([paths[0], other])


def test_the_command_says_who_is_tested_on(table, tmp_path, capsys):
    words = ["split-dataset", str(table.folder), "--fold", "2/3", "--out", str(tmp_path / "two")]
    report = reported(words, SplitReport, capsys)
    assert report.tested == sorted(_tested(SequenceTable.open(tmp_path / "two"), "participant_id"))
    assert sum(report.sequences.values()) == table.scalars().num_rows
    refused([*words[:3], "half", *words[4:]], capsys, code=UsageError.exit_code, message="expected K/N")
