"""Folds of participants share nobody, cover everybody, and merge into one score."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pyarrow as pa
import pytest

from prbench.board import merging
from prbench.board.collect import CollectedRuns, collect_runs
from prbench.board.comparison import compare_runs
from prbench.board.export import part_title
from prbench.board.merging import merge_folds, run_folds
from prbench.board.tables import make_leaderboard, undecided_lines
from prbench.cli.main import main
from prbench.errors import RunError, StorageError, TableError, UsageError
from prbench.harness.first_run import table_finder
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker, summary_of
from prbench.harness.run import RunReport, run_method
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.scores import read_scores, write_scores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.sequences import SequenceTable
from prbench.sequences.folds import participant_folds, participant_units, write_fold
from prbench.sequences.sequence import recording_key
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


def test_somebody_with_as_many_sequences_as_all_others_has_a_fold_alone():
    people = ["a"] * 5 + list("bcdef")
    rows = pa.table({"participant_id": people, "split_group": [f"{name}{place}" for place, name in enumerate(people)]})
    table: Any = SimpleNamespace(scalars=rows.select)
    assert participant_folds(table, 2) == {"a": 1} | dict.fromkeys("bcdef", 2)


def test_what_cannot_be_split_is_refused(table, folds, tmp_path):
    with pytest.raises(TableError, match="expected at least 9 participants"):
        participant_folds(table, 9)
    with pytest.raises(UsageError, match="is fold 1/3 already"):
        write_fold(folds[0], tmp_path / "again", fold=1, folds=3)
    with pytest.raises(UsageError, match="expected K/N"):
        write_fold(table, tmp_path / "again", fold=4, folds=3)


def test_merged_folds_are_the_scores_of_all_sequences(table, folds, tmp_path, capsys):
    paths = []
    for number, fold in enumerate(folds):
        paths.append(tmp_path / f"run-{number}")
        run_method(RunRequest(method="scripted", data=(fold.folder,), out=paths[-1]))
    merged = merge_folds(paths[::-1]).summary
    assert merged.sequences == table.scalars().num_rows
    assert merged.split == "3 folds"
    (run,) = reported(["merge", *map(str, paths), "--out", str(tmp_path / "merged")], capsys, kind="of runs").runs
    assert run.datasets[0].sequences == merged.sequences
    with pytest.raises(RunError, match="fold 1/3 is that of"):
        merge_folds([paths[0], paths[0]])
    with pytest.raises(RunError, match="each of the 3 folds, found none of 2"):
        merge_folds([paths[0], paths[2]])
    whole = tmp_path / "whole"
    run_method(RunRequest(method="scripted", data=(table.folder,), out=whole))
    with pytest.raises(RunError, match="expected whole_table"):
        merge_folds([paths[0], whole])
    with pytest.raises(RunError, match="found one on a table that is no fold"):
        merge_folds([whole, whole])
    with pytest.raises(RunError, match="expected a run of each fold"):
        merge_folds(paths[:1])
    other = tmp_path / "other"
    run_method(RunRequest(method="ground-truth", data=(folds[1].folder,), out=other))
    with pytest.raises(RunError, match="expected method name scripted"):
        merge_folds([paths[0], other])


def test_motions_made_elsewhere_are_scored_on_folds_and_merged(table, fold_runs, tmp_path, capsys):
    scored = []
    for number, run in enumerate(fold_runs, 1):
        fold = ["--data", str(table.folder), "--fold", f"{number}/3"]
        asked = ["export-conditions", "--condition", "goal-loc", "--out", str(tmp_path / "c.npz"), *fold]
        assert reported(asked, capsys).sequences == {"synthetic-adt": RunFolder.open(run).record.tables[0].sequences}
        scored.append(str(tmp_path / f"scored-{number}"))
        (motions,) = run.rglob("part-*.parquet")
        named = ["--name", "mine", "--condition", "goal-loc", *fold]
        assert main(["score", str(motions), *named, "--out", scored[-1]]) == 0
    assert main(["merge", *scored, "--out", str(tmp_path / "merged")]) == 0
    summary = DatasetSummary.read(tmp_path / "merged/synthetic-adt")
    people = set(table.scalars()["participant_id"].to_pylist())
    assert (summary.sequences, summary.recordings) == (table.scalars().num_rows, len(people))
    half = ["score", scored[0], "--data", str(table.folder), "--fold", "half"]
    refused(half, capsys, code=UsageError.exit_code, message="--fold half: expected K/N")


def _runs_of_folds(table, root, method="scripted"):
    paths = []
    for fold in ("1/3", "2/3", "3/3"):
        paths.append(root / f"{method}-{fold[0]}")
        words = ["run", "--method", method, "--data", str(table.folder), "--fold", fold]
        assert main([*words, "--out", str(paths[-1])]) == 0
    return paths


@pytest.fixture(scope="module")
def fold_runs(table, tmp_path_factory):
    root = tmp_path_factory.mktemp("fold-runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PRBENCH_CACHE", str(root / "cache"))
        yield _runs_of_folds(table, root)


def test_a_run_on_a_fold_is_that_on_the_table_of_the_fold_and_says_so(table, folds, fold_runs, tmp_path, capsys):
    made = RunFolder.open(fold_runs[1]).record
    assert made.tables[0].fold == "2/3"
    assert made.tables[0].whole_table == table.info.content_digest
    run_method(RunRequest(method="scripted", data=(folds[1].folder,), out=tmp_path / "beside"))
    assert RunFolder.open(tmp_path / "beside").record == made
    repeated = tmp_path / "repeated"
    words = ["run", "--config", str(fold_runs[1]), "--data", str(table.folder), "--out", str(repeated)]
    assert main(words) == 0
    assert RunFolder.open(repeated).record == made
    assert "every score is the same" in capsys.readouterr().err


def test_a_fold_that_cannot_be_is_refused(table, fold_runs, tmp_path, capsys):
    words = ["run", "--method", "scripted", "--data", str(table.folder), "--out", str(tmp_path / "run")]
    for more, message in {
        ("--fold", "1/3", "--split", "train"): "--fold says already who is tested on; leave --split out",
        ("--fold", "4/3"): "--fold 4/3: expected K/N",
        ("--folds", "people"): "--fold people: expected K/N, such as 2/6.",
        ("--folds", "participants"): "2/6. All folds together are `prbench run --folds participant`'s.",
        ("--folds", "partcipant"): "2/6. All folds together are `prbench run --folds participant`'s.",
        ("--folds", "participant", "--shard", "1/2"): "which --data names; leave --view and --shard out",
        ("--folds", "participant", "--data", str(tmp_path)): "merges runs on all folds of one table",
    }.items():
        refused([*words, *more], capsys, code=UsageError.exit_code, message=message)
    # A run folder never goes on with another fold.
    other = ["--fold", "1/3", "--out", str(fold_runs[1])]
    refused([*words[:5], *other], capsys, code=RunError.exit_code, message="fold: expected 1/3 for this run, found 2/3")


def test_an_experiment_may_be_of_a_fold(table, fold_runs, tmp_path):
    file = tmp_path / "experiment.toml"
    file.write_text(f'data = [{str(table.folder)!r}]\nfold = "3/3"\n[[methods]]\nname = "scripted"\n')
    assert main(["run", "--config", str(file), "--out", str(tmp_path / "run")]) == 0
    assert RunFolder.open(tmp_path / "run").record == RunFolder.open(fold_runs[2]).record


def test_merged_scores_stand_beside_others_and_are_held_against_their_runs(table, fold_runs, tmp_path, capsys):
    out = tmp_path / "merged"
    merge = ["merge", *map(str, fold_runs), "--out", str(out)]
    assert len(reported(merge, capsys, kind="of runs").runs) == 1
    before = {path: path.read_bytes() for path in out.rglob("*.*")}
    assert main(merge) == 0, "the same again changes nothing"
    assert {path: path.read_bytes() for path in out.rglob("*.*")} == before
    (board,) = collect_runs([out]).rows
    assert "name them, too" in board.unverified
    assert board.summary.sequences == table.scalars().num_rows
    (board,) = collect_runs([out, *fold_runs], check=RunChecker(table_finder([])).check).rows
    assert board.unverified == "", "the tables of the folds stand in the cache"
    alone = collect_runs(fold_runs).rows
    assert {row.table.fold for row in alone} == {"1/3", "2/3", "3/3"}
    assert len(make_leaderboard(CollectedRuns(alone, ())).tables) == 3, "different folds never share a table"


def test_forged_merged_scores_are_refused(fold_runs, tmp_path, capsys):
    out = tmp_path / "merged"
    merge_folds(fold_runs).write(out)
    summary = DatasetSummary.read(out / "synthetic-adt")
    better = msgspec.structs.replace(summary.metrics[0], mean=0.99)
    msgspec.structs.replace(summary, metrics=(better, *summary.metrics[1:])).write(out / "synthetic-adt")
    with pytest.raises(RunError, match="follows from"):
        collect_runs([out])
    scores = read_scores(out / "synthetic-adt/scores.parquet")
    scores = scores.set_column(4, scores.schema.field("value"), pa.array(0.5 * scores["value"].to_numpy()))
    write_scores(out / "synthetic-adt/scores.parquet", [scores])
    record = RunFolder.open(out).record
    names = {name: recording_key(name) for name in scores["sequence_id"].to_pylist()}
    summary_of(record, record.tables[0], scores, names).write(out / "synthetic-adt")
    assert collect_runs([out]).rows[0].unverified, "alone it cannot be known, and is not called verified"
    with pytest.raises(RunError, match="does not follow from the runs"):
        collect_runs([out, *fold_runs])
    words = ["merge", *map(str, fold_runs), "--out"]
    refused(
        [*words, str(fold_runs[0])],
        capsys,
        code=StorageError.exit_code,
        message="something else than these runs merged",
    )


@pytest.fixture(scope="module")
def every_fold(table, fold_runs, tmp_path_factory):
    """Runs of two methods on all folds of one table, and the words of the first."""
    root = tmp_path_factory.mktemp("every")
    words = ["run", "--method", "scripted", "--data", str(table.folder), "--folds", "participant"]
    assert main([*words, "--out", str(root / "scripted")]) == 0
    assert main([*words[:2], "static", *words[3:], "--out", str(root / "static")]) == 0
    return root, [*words, "--out", str(root / "scripted")]


def test_a_run_on_all_folds_tests_everybody_once_and_goes_on_where_it_was(table, every_fold, capsys):
    root, words = every_fold
    people = set(table.scalars()["participant_id"].to_pylist())
    runs = sorted((root / "scripted").glob("fold-*"))
    assert len(runs) == len(people)
    for run in runs:
        assert len(set(RunFolder.open(run).record.tables[0].units.values())) == 1, "nobody else is tested on"
    merged = RunFolder.open(root / "scripted")
    assert merged.path.name == "merged", "the folder of the folds stands for what they are together"
    summary = DatasetSummary.read(merged.path / "synthetic-adt")
    assert (summary.sequences, summary.recordings) == (table.scalars().num_rows, len(people))
    before = {path: path.read_bytes() for path in root.rglob("scripted/**/*.*") if path.name != "cost.json"}
    for half_done in (runs[-1] / "synthetic-adt/scores.parquet", runs[-1] / "synthetic-adt/summary.json"):
        half_done.unlink()
    assert reported(words, capsys).runs
    assert {path: path.read_bytes() for path in before} == before


def test_merged_folds_stand_in_a_table_of_their_own_whose_units_are_participants(table, every_fold, tmp_path, capsys):
    root, _ = every_fold
    people = len(set(table.scalars()["participant_id"].to_pylist()))
    for method in ("scripted", "static"):
        assert main(["run", "--method", method, "--data", str(table.folder), "--out", str(tmp_path / method)]) == 0
    capsys.readouterr()
    paths = [root / "scripted", root / "static", tmp_path / "scripted", tmp_path / "static"]
    collected = collect_runs(paths, check=RunChecker(table_finder([table.folder])).check)
    assert [row.unverified for row in collected.rows] == [""] * 4, "the runs on the folds lie beside the merged one"
    folds, test = make_leaderboard(collected).tables
    assert (folds.split, folds.recordings, test.split) == (f"{people} folds", people, "test")
    assert part_title(folds).endswith(f"{people} participants")
    assert people < 9
    assert not any(row.leads or any(row.beaten_by.values()) for row in folds.rows), "few units lead nowhere"
    assert f"{people} participants, where a comparison of 2 methods needs" in undecided_lines(folds)[0]
    compared = compare_runs(root / "scripted", root / "static").metrics
    assert {each.comparison.difference.n_recordings for each in compared} == {people}


def test_weights_of_a_fold_are_named_by_its_number(table, every_fold, monkeypatch):
    root, _ = every_fold
    made = sorted((root / "static").glob("fold-*"))
    asked = []

    def made_before(request, **_):
        asked.append((request.fold, request.weights))
        return RunReport(RunFolder.open(made[len(asked) - 1]), (), 0, 0)

    monkeypatch.setattr(merging, "run_method", made_before)
    request = RunRequest(method="static", data=(table.folder,), out=root / "static", weights=Path("w-{fold}/a.bin"))
    run_folds(request)
    assert asked[1] == (f"2/{len(made)}", Path("w-2/a.bin"))


@pytest.mark.parametrize(
    ("digests", "said"), [("ddd", "a.bin, the same in every fold"), ("abc", "3 folds"), ((None,) * 3, "a.bin")]
)
def test_weights_that_no_fold_has_trained_are_called_the_same(fold_runs, tmp_path, digests, said):
    runs = [shutil.copytree(run, tmp_path / run.name) for run in fold_runs]
    for run, digest in zip(runs, digests, strict=True):
        record = RunFolder.open(run).record
        method = msgspec.structs.replace(record.method, weights="a.bin", weights_digest=digest)
        msgspec.structs.replace(record, method=method).write(run)
    assert merge_folds(runs).record.method.weights == said


def test_participants_who_were_recorded_together_are_one_unit(table):
    assert participant_units(table) == {name: name for name in participant_units(table)}
    rows = pa.table({"participant_id": ["b", "a", "c", "d"], "split_group": ["x", "x", "y", "z"]})
    together: Any = SimpleNamespace(scalars=rows.select)
    assert participant_units(together) == {"a": "a", "b": "a", "c": "c", "d": "d"}
