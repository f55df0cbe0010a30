"""The same method in process and offline: the same ids, the same conditions, and identical scores."""

from __future__ import annotations

import dataclasses
import itertools
import pickle

import msgspec
import numpy as np
import pytest

from prbench.board import tables as tables_of_board
from prbench.board.collect import collect_runs
from prbench.board.export import export as export_board
from prbench.contract import GIVEN, Condition, ConditionBatch
from prbench.errors import PredictionsError, RunError, UsageError
from prbench.harness import planning
from prbench.harness import prime_and_reach as question
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.offline import ExportRequest, export_conditions, read_conditions_file, write_conditions
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder, read_scores
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from tests.fakes import STANDING, fake_dataset
from tests.harness.offline import method

FORMS = {
    "nested": lambda path, *rest: method.write_parquet(path / "made.parquet", *rest, flat=False),
    "flat": lambda path, *rest: method.write_parquet(path / "made.parquet", *rest, flat=True),
    "padded": lambda path, *rest: method.write_padded(path / "made.npz", *rest),
    "ragged": lambda path, *rest: method.write_ragged(path / "made.npz", *rest),
    "named": lambda path, *rest: method.write_named(path / "made.npz", *rest),
}
VARIANTS = [
    {"condition": "goal-loc", "samples": 2, "seed": 5},
    {"condition": "goal-pose"},
    {"condition": "none", "limit": 6, "split": "validation"},
    {"condition": "text", "native_fps": 30.0},
    {"condition": "goal-loc", "native_fps": 12.5, "max_frames": 60, "samples": 2},
    {"condition": "goal-loc", "control": "shuffled-goal", "seed": 2},
]


@pytest.fixture(scope="module")
def tables(table, tmp_path_factory):
    return table, fake_dataset(tmp_path_factory.mktemp("other") / "table", 24, dataset="synthetic-gimo")


@pytest.fixture(autouse=True)
def drift(install):
    install("drift", method.SOURCE)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """A folder for the run and the export that every form of predictions is compared with."""
    return tmp_path_factory.mktemp("shared")


def run(tables, out, *, condition, native_fps=None, max_frames=None, **changes):
    given = {"native_fps": native_fps, "max_frames": max_frames}
    return run_method(
        RunRequest(
            method="drift",
            data=tuple(table.folder for table in tables),
            condition=Condition(condition),
            options={name: str(value) for name, value in given.items() if value is not None},
            out=out,
            batch_size=4,
            **changes,
        )
    )


def export(tables, path, *, condition, **changes):
    folders = tuple(table.folder for table in tables)
    export_conditions(ExportRequest(data=folders, condition=Condition(condition), out=path, **changes))
    return read_conditions_file(path)


def made(tables, folder, **variant):
    """Conditions in ``c.npz``, and the file of what the method makes of them."""
    conditions = export(tables, folder / "c.npz", **variant)
    return conditions, method.write_padded(folder / "made.npz", conditions, method.generated(conditions))


def score(tables, path, engine=None, **changes):
    folders = tuple(table.folder for table in tables)
    return score_predictions(ScoreRequest(predictions=path, data=folders, **changes), engine=engine)


def scores_of(folder):
    """The rows of each dataset's scores.parquet."""
    opened = RunFolder.open(folder)
    return {each.dataset: read_scores(opened.dataset(each.dataset).scores) for each in opened.record.tables}


def test_in_process_isolated_and_offline_the_scores_are_the_same_bytes(table, tmp_path):
    for name, isolate in (("inside", False), ("isolated", True)):
        run([table], tmp_path / name, **VARIANTS[0], isolate=isolate)
    _, path = made([table], tmp_path, **VARIANTS[0])
    score([table], path, conditions=tmp_path / "c.npz", out=tmp_path / "offline", name="drift")
    inside, *others = (
        (tmp_path / name / "synthetic-adt/scores.parquet").read_bytes() for name in ("inside", "isolated", "offline")
    )
    assert others == [inside] * 2


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_predictions_scores_as_the_run_does(tables, shared, tmp_path, form):
    if not (shared / "c.npz").exists():
        run(tables, shared / "run", **VARIANTS[0])
        export(tables, shared / "c.npz", **VARIANTS[0])
    conditions = read_conditions_file(shared / "c.npz")
    path = FORMS[form](tmp_path, conditions, method.generated(conditions))
    reports = score(tables, path, conditions=shared / "c.npz", out=tmp_path / "offline", name="drift")
    expected = scores_of(shared / "run")
    assert [report.summary.dataset for report in reports] == list(expected) == ["synthetic-adt", "synthetic-gimo"]
    for report in reports:
        assert report.scores.equals(expected[report.summary.dataset])
        assert report.scores.equals(read_scores(report.folder / "scores.parquet"))
        written = RunFolder.open(shared / "run").dataset(report.summary.dataset)
        assert (report.folder / "scores.parquet").read_bytes() == written.scores.read_bytes()
        assert (report.folder / "summary.json").read_bytes() == (written.path / "summary.json").read_bytes()


@pytest.mark.parametrize("variant", VARIANTS[1:], ids=str)
def test_every_kind_of_run_scores_alike_offline(tables, tmp_path, variant):
    own = run(tables, tmp_path / "run", **variant).summaries
    _, path = made(tables, tmp_path, **variant)
    reports = score(tables, path, conditions=tmp_path / "c.npz", name="drift")
    assert tuple(report.summary for report in reports) == own
    for report in reports:
        assert report.scores.equals(scores_of(tmp_path / "run")[report.summary.dataset])
    if "max_frames" in variant:
        assert any(report.summary.unsupported for report in reports)


def test_workers_and_small_windows_change_nothing(table, tmp_path, monkeypatch):
    conditions = export([table], tmp_path / "c.npz", **VARIANTS[4])
    path = method.write_ragged(tmp_path / "made.npz", conditions, method.generated(conditions))
    (whole,) = score([table], path, conditions=tmp_path / "c.npz")
    monkeypatch.setattr(planning, "WINDOW", 5)
    (parts,) = score([table], path, conditions=tmp_path / "c.npz")
    assert parts.scores.equals(whole.scores)
    (spread,) = score([table], path, conditions=tmp_path / "c.npz", engine=Elsewhere())
    assert spread.scores.equals(whole.scores)


class Elsewhere:
    """Hands everything over as to another process."""

    def map(self, function, items, *, if_full=None):
        return (pickle.loads(pickle.dumps(function))(pickle.loads(pickle.dumps(item))) for item in items)


def seen_in_a_run(monkeypatch) -> list[ConditionBatch]:
    """Every batch that a method is given from now on."""
    seen: list[ConditionBatch] = []
    ask = question.generate_checked

    def watched(adapter, batch, **rest):
        seen.append(batch)
        return ask(adapter, batch, **rest)

    monkeypatch.setattr(question, "generate_checked", watched)
    return seen


def row_of(batch: ConditionBatch, i: int):
    """Everything that one row holds, comparable."""
    given = {name: getattr(batch, name)[i] for name in sorted(GIVEN[batch.condition])}
    shown = {name: value if isinstance(value, str) else value.tobytes() for name, value in given.items()}
    return batch.opaque_id[i], batch.noise_seed[i], int(batch.n_frames[i]), batch.fps, shown


def test_the_file_holds_what_a_run_and_a_resumed_run_show(tables, tmp_path, monkeypatch):
    variant = VARIANTS[0]
    seen = seen_in_a_run(monkeypatch)
    run(tables, tmp_path / "run", **variant)
    shown = sorted((row_of(batch, i) for batch in seen for i in range(len(batch))), key=lambda row: row[:2])
    conditions = export(tables, tmp_path / "c.npz", **variant)
    exported = [row_of(batch, i) for rows, batch in method.batches_of(conditions, 7) for i in range(len(rows))]
    assert sorted(exported, key=lambda row: row[:2]) == shown

    seen.clear()
    (tmp_path / "run/synthetic-gimo/predictions/part-00000.parquet").unlink()
    (tmp_path / "run/synthetic-gimo/summary.json").unlink()
    run(tables, tmp_path / "run", **variant)
    again = [row_of(batch, i) for batch in seen for i in range(len(batch))]
    assert len(again) == 4 * 2
    assert all(row in shown for row in again)


def test_sequence_ids_do_as_well_and_need_no_seed(table, tmp_path):
    conditions = export([table], tmp_path / "c.npz", condition="text", seed=8)
    motions = method.generated(conditions)
    by_opaque = method.write_padded(tmp_path / "opaque.npz", conditions, motions)
    (expected,) = score([table], by_opaque, seed=8)
    ids = planning.select(table, split="test", limit=None).sequence_ids
    name_of = dict(zip(opaque_ids(ids, run_salt(8, table.identity)), ids))
    np.savez(
        tmp_path / "named.npz",
        sequence_id=np.array([name_of[name] for name in conditions.opaque_id]),
        n_frames=conditions.n_frames,
        joints=np.concatenate(motions),
    )
    (named,) = score([table], tmp_path / "named.npz")
    assert named.scores.equals(expected.scores)
    assert (named.summary.method, named.summary.condition) == ("named", "unstated")


def test_another_seed_is_noticed(table, tmp_path):
    _, path = made([table], tmp_path, condition="none", seed=41)
    with pytest.raises(PredictionsError, match=r"is --seed 0 that of the run"):
        score([table], path)
    with pytest.raises(UsageError, match=r"--seed 3: .*c.npz was exported with 41. Leave --seed out"):
        score([table], path, conditions=tmp_path / "c.npz", seed=3)
    assert score([table], path, seed=41)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"condition": Condition.TEXT}, "--condition text: .*c.npz was exported with goal-loc"),
        ({"split": "train"}, "--split train: .*exported with test"),
        ({"limit": 3}, "--limit 3: .*exported with none"),
        ({"native_fps": 30.0}, "--native-fps 30.0: .*exported with none"),
        ({"control": "shuffled-goal"}, "--control shuffled-goal: the goals in .*c.npz are each sequence's own"),
    ],
)
def test_what_contradicts_the_conditions_file_is_refused(table, tmp_path, changes, message):
    _, path = made([table], tmp_path, condition="goal-loc")
    with pytest.raises(UsageError, match=message):
        score([table], path, conditions=tmp_path / "c.npz", **changes)


def test_conditions_of_other_tables_are_refused(tables, tmp_path):
    _, path = made(tables, tmp_path, condition="none")
    with pytest.raises(PredictionsError, match=r"c.npz: expected conditions of .*, found those of 2 tables"):
        score(tables[:1], path, conditions=tmp_path / "c.npz")


def test_a_changed_conditions_file_is_refused_by_column_and_row(table, tmp_path):
    conditions, path = made([table], tmp_path, condition="goal-loc")
    goals = conditions.goal_location.copy()
    goals[4] += 0.1
    write_conditions(dataclasses.replace(conditions, goal_location=goals), tmp_path / "c.npz")
    with pytest.raises(PredictionsError, match=r"c.npz, column 'goal_location', row 4: expected what .* give"):
        score([table], path, conditions=tmp_path / "c.npz")


def test_a_file_that_claims_more_samples_than_it_has_is_refused_at_once(table, tmp_path):
    conditions = export([table], tmp_path / "c.npz", condition="none")
    claimed = msgspec.structs.replace(conditions.info, samples=10**9)
    write_conditions(dataclasses.replace(conditions, info=claimed), tmp_path / "c.npz")
    with pytest.raises(PredictionsError, match=r"c.npz: expected rows of 1000000000 samples, found 1"):
        score([table], tmp_path / "made.npz", conditions=tmp_path / "c.npz")


def test_a_conditions_file_that_was_not_used_is_named(table, tmp_path):
    conditions = export([table], tmp_path / "used.npz", condition="none", seed=1)
    path = method.write_padded(tmp_path / "made.npz", conditions, method.generated(conditions))
    export([table], tmp_path / "other.npz", condition="none", seed=2)
    with pytest.raises(PredictionsError, match=r"None of the ids stands in .*other.npz"):
        score([table], path, conditions=tmp_path / "other.npz")


def test_samples_that_were_not_asked_for_or_not_numbered_are_refused(table, tmp_path):
    _, path = made([table], tmp_path, condition="none", samples=2)
    export([table], tmp_path / "single.npz", condition="none")
    with pytest.raises(PredictionsError, match=r"found 15: missing 0, .*, samples that were not asked for \[1\]"):
        score([table], path, conditions=tmp_path / "single.npz")
    with np.load(path) as arrays:
        kept = {name: arrays[name] for name in arrays.files if name != "sample"}
    np.savez(path, **kept)
    with pytest.raises(PredictionsError, match=r"repeated 15 .*number them from 0 in 'sample'"):
        score([table], path, conditions=tmp_path / "c.npz")


def test_missing_sequences_of_several_tables_stand_in_one_message(tables, tmp_path):
    conditions = export(tables, tmp_path / "c.npz", condition="none")
    part = conditions.rows(np.arange(2, len(conditions)))
    path = method.write_padded(tmp_path / "made.npz", part, method.generated(part))
    with pytest.raises(
        PredictionsError,
        match=r"the 15 test sequences of synthetic-adt and 6 test sequences of synthetic-gimo, found 19: missing 2",
    ):
        score(tables, path, conditions=tmp_path / "c.npz")


def test_offline_scores_stand_in_a_leaderboard_beside_runs(tables, tmp_path):
    run(tables, tmp_path / "runs/inside", **VARIANTS[1])
    _, path = made(tables, tmp_path, **VARIANTS[1])
    for _ in range(2):  # the same again is no mistake
        score(tables, path, conditions=tmp_path / "c.npz", out=tmp_path / "runs/outside", name="drifted")
    collected = collect_runs([tmp_path / "runs"])
    rows = collected.rows
    assert [(row.method, row.record.method.kind, row.record.condition) for row in rows] == [
        ("drift", "package", "goal-pose"),
        ("drift", "package", "goal-pose"),
        ("drifted", "file", "goal-pose"),
        ("drifted", "file", "goal-pose"),
    ]
    for inside, outside in itertools.product(rows[:2], rows[2:]):
        if inside.summary.dataset == outside.summary.dataset:
            assert inside.summary.metrics == outside.summary.metrics
            assert inside.table.selection_digest == outside.table.selection_digest
    assert all(
        "drifted" in export_board(tables_of_board.make_leaderboard(collected), kind) for kind in ("md", "csv", "json")
    )


def test_scores_of_an_unstated_condition_are_shown_without_rank(table, tmp_path, monkeypatch):
    monkeypatch.setattr(tables_of_board, "FEWEST_RANKED", 1)
    conditions = export([table], tmp_path / "c.npz", condition="text")
    motions = [np.repeat(STANDING[None], len(motion), axis=0) for motion in method.generated(conditions)]
    for name, condition, off in (("one", Condition.TEXT, 0), ("two", Condition.TEXT, 0.02), ("three", None, 0.04)):
        path = method.write_padded(tmp_path / f"{name}.npz", conditions, [motion + off for motion in motions])
        score([table], path, out=tmp_path / "scores" / name, condition=condition)
    board = tables_of_board.make_leaderboard(collect_runs([tmp_path / "scores"]))
    ranked = {row.entry.method: (row.entry.record.condition, bool(row.ranks)) for row in board.tables[0].rows}
    assert ranked == {"one": ("text", True), "two": ("text", True), "three": ("unstated", False)}
    assert all("unstated" in export_board(board, kind) for kind in ("md", "csv", "json"))


def test_another_submission_does_not_replace_scores(table, tmp_path):
    conditions = export([table], tmp_path / "c.npz", condition="none")
    for number in (1, 2):
        motions = [motion + number for motion in method.generated(conditions)]
        method.write_padded(tmp_path / f"made{number}.npz", conditions, motions)
    score([table], tmp_path / "made1.npz", out=tmp_path / "out")
    with pytest.raises(RunError, match=r"run.json, method\.name: expected made2 for this run, found made1"):
        score([table], tmp_path / "made2.npz", out=tmp_path / "out")
    with pytest.raises(RunError, match=r"out: holds the scores of made1.npz, not its motions"):
        score([table], tmp_path / "out")


def test_a_run_says_itself_how_it_was_made(table, tmp_path):
    run([table], tmp_path / "run", **VARIANTS[1], limit=2)
    for name, value in (("native_fps", 30.0), ("seed", 0), ("name", "mine")):
        option = name.replace("_", "-")
        with pytest.raises(UsageError, match=f"--{option}: .* is a run, whose run.json says how"):
            score([table], tmp_path / "run", **{name: value})


def test_a_limit_that_leaves_nothing_is_refused(table, tmp_path):
    with pytest.raises(UsageError, match="--max-frames 10: all 15 chosen sequences of synthetic-adt are longer"):
        score([table], tmp_path / "made.npz", max_frames=10)
