"""Submissions are scored again from their motions, and forgeries that hold together on the outside are refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.board.submission import RUNS, TrainingData, TrainingDataset, declared_training, open_submission
from prbench.board.verifying import verify_submission
from prbench.cli.main import main
from prbench.errors import PrbenchError
from prbench.harness.run_folder.scores import read_scores, write_scores
from tests.board.submissions import (
    DATASET,
    PREDICTIONS,
    edit_json,
    edit_motions,
    forged,
    made,
    moved_table,
    score_again,
    submitted,
)


def verified(file: Path, *data: Path):
    folder = file.parent / "verified"
    return verify_submission(open_submission(file, folder), folder, data or [made() / "table"])


def test_an_honest_submission_is_verified_on_the_same_table(tmp_path):
    found = verified(submitted(tmp_path / "a.zip", "still", "scripted", "people"))
    assert found.verdict == (
        "verified on tables of the same values: 3 runs, 24 sequences scored again; every score follows from its motion"
    )
    assert {(each.run, each.same_values, each.sequences) for each in found.datasets} == {
        ("people", True, 8), ("scripted", True, 8), ("still", True, 8),
    }  # fmt: skip
    assert all(drift.drift == 0 and drift.stored == drift.rescored for each in found.datasets for drift in each.metrics)


def test_other_values_of_the_same_sequences_drift_and_say_by_how_much(tmp_path):
    found = verified(submitted(tmp_path / "a.zip", "still"), moved_table(tmp_path / "moved", 4e-4))
    (each,) = found.datasets
    drifts = {drift.metric: drift for drift in each.metrics}
    assert not each.same_values
    assert 1e-4 < drifts["mpjpe"].drift < 1e-3 == drifts["mpjpe"].accepted
    assert drifts["mpjpe"].rescored != drifts["mpjpe"].stored
    assert "same sequences with other values" in found.verdict
    assert "largest drift 0.000" in found.verdict


def edited_scores(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """Change every MPJPE; the summary stays."""

    def forge(run: Path) -> None:
        path = run / DATASET / "scores.parquet"
        scores = read_scores(path)
        values = scores["value"].to_numpy().copy()
        chosen = np.flatnonzero(np.array(scores["metric"].to_pylist()) == "mpjpe")
        values[chosen] = change(values[chosen])
        write_scores(path, [scores.set_column(scores.schema.get_field_index("value"), "value", pa.array(values))])

    return forge


def thirds(values: np.ndarray) -> np.ndarray:
    return values / 3


def exchanged(values: np.ndarray) -> np.ndarray:
    """Every mean and the summary stay right."""
    return np.roll(values, 2)


def motions(change: Callable[[list[dict]], list[dict]]) -> Callable[[Path], None]:
    return lambda run: edit_motions(run, change)


def with_frame(value: float) -> Callable[[list[dict]], list[dict]]:
    def change(rows: list[dict]) -> list[dict]:
        rows[2]["joints"][5][4] = value
        return rows

    return change


def endless_samples(run: Path) -> None:
    for path in (run / "run.json", run / DATASET / "summary.json"):
        edit_json(path, samples=10**12)


def add_column(run: Path) -> None:
    rows = pq.read_table(run / PREDICTIONS)
    pq.write_table(rows.append_column("recorded", rows["joints"]), run / PREDICTIONS)


def take_people(run: Path) -> None:
    """The method hands in recorded motion; everything follows from it."""
    rows = {
        row["sequence_id"]: row["joints"] for row in pq.read_table(made() / "runs/people" / PREDICTIONS).to_pylist()
    }
    edit_motions(run, lambda found: [row | {"joints": rows[row["sequence_id"]]} for row in found])
    score_again(run)


def conceal_faults(run: Path) -> None:
    """Motions in centimetres, scored by prbench; the summary keeps silent about them."""

    def large(rows: list[dict]) -> list[dict]:
        return [row | {"joints": [[40 * number for number in frame] for frame in row["joints"]]} for row in rows]

    edit_motions(run, large)
    score_again(run)
    summary = run / DATASET / "summary.json"
    assert json.loads(summary.read_text())["findings"]
    edit_json(summary, findings=[])


def table_of(run: Path, **values: object) -> None:
    record = json.loads((run / "run.json").read_text())
    edit_json(run / "run.json", tables=[record["tables"][0] | values])


def method_of(run: Path, **values: object) -> None:
    record = json.loads((run / "run.json").read_text())
    edit_json(run / "run.json", method=record["method"] | values)


FORGERIES = {
    "changed scores": (edited_scores(thirds), "summary.json, mpjpe.* follows from"),
    "scores of other sequences": (edited_scores(exchanged), "scores.parquet.*expected .* which the motion"),
    "changed summary": (lambda run: edit_json(run / DATASET / "summary.json", recordings=99), "recordings: expected"),
    "changed motions": (motions(with_frame(0.5)), "scores.parquet, row .* from the motions and their table, found"),
    "a missing sequence": (motions(lambda rows: rows[1:]), r"missing 1 \(synthetic-adt/.*, sample 0\), repeated 0"),
    "a repeated sequence": (motions(lambda rows: [*rows, rows[0]]), r"repeated 1 \(synthetic-adt/rec"),
    "an unknown sequence": (
        motions(lambda rows: [*rows, rows[0] | {"sequence_id": "made/up"}]), r"unknown 1 \(made/up, sample 0\)",
    ),
    "another sample": (motions(lambda rows: [*rows, rows[0] | {"sample": 1}]), "unknown 1"),
    "samples without end": (endless_samples, "missing 64 "),
    "recorded motion beside the method's": (add_column, "expected the columns of motions alone, found recorded"),
    "not finite": (motions(with_frame(float("nan"))), "frame 5.*nan"),
    "far away": (motions(with_frame(1e6)), "frame 5"),
    "too short": (
        motions(lambda rows: [rows[0] | {"joints": rows[0]["joints"][:-1]}, *rows[1:]]), "expected .* frames, found",
    ),
    "copies of recorded motion": (take_people, "expected motions of the method, found the recorded ones in 8 of 8"),
    "concealed faults": (conceal_faults, "findings: expected .*scale.* found none|findings: expected"),
    "another protocol": (lambda run: edit_json(run / "run.json", protocol_digest="0" * 64), "another protocol"),
    "another table": (lambda run: table_of(run, identity_digest="0" * 64), "found others .fd07b69aa634"),
    "other sequences": (lambda run: table_of(run, sequences=9), "tables.synthetic-adt.sequences|sequences: expected"),
    "another dataset": (lambda run: table_of(run, title="The real one"), "title"),
    "another condition": (lambda run: edit_json(run / "run.json", seed=7), "condition, control, seed"),
    "a control's name": (lambda run: method_of(run, kind="control", name="scripted"), "method"),
    "a method of prbench": (lambda run: method_of(run, name="pr"), "method|condition"),
    "no motions": (lambda run: (run / PREDICTIONS).unlink(), "holds no motions"),
    "unfinished": (lambda run: (run / DATASET / "summary.json").unlink(), "not finished on synthetic-adt"),
}  # fmt: skip


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forgery_is_refused_with_its_reason(tmp_path, name):
    forge, message = FORGERIES[name]
    with pytest.raises(PrbenchError, match=message):
        verified(forged(tmp_path, forge))


def forget_remarks(run: Path) -> None:
    """Nothing says any more why motions are implausible."""
    path = run / DATASET / "scores.parquet"
    scores = read_scores(path)
    write_scores(path, [scores.set_column(scores.schema.get_field_index("flag"), "flag", pa.nulls(len(scores)))])
    summary = json.loads((run / DATASET / "summary.json").read_text())
    edit_json(run / DATASET / "summary.json", metrics=[each | {"flags": {}} for each in summary["metrics"]])


def test_remarks_are_not_lost_in_the_drift_of_another_table(tmp_path):
    with pytest.raises(PrbenchError, match="expected the remarks that the motions earn, found others in"):
        verified(forged(tmp_path, forget_remarks), moved_table(tmp_path / "moved", 2e-4))


@pytest.mark.parametrize("name", ["scores of other sequences", "changed motions", "copies of recorded motion"])
def test_no_forgery_hides_in_the_drift_of_another_table(tmp_path, name):
    forge, message = FORGERIES[name]
    with pytest.raises(PrbenchError, match=f"{message}|found .* of difference in the mean|expected the remarks"):
        verified(forged(tmp_path, forge), moved_table(tmp_path / "moved", 2e-4))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (lambda folder: moved_table(folder, 0.05), "expected values within 0.005 .* found 0.125 of"),
        (lambda folder: moved_table(folder, 0.0, sequences=28), "expected the sequences of synthetic-adt"),
    ],
)
def test_a_table_of_other_data_verifies_nothing(tmp_path, table, message):
    with pytest.raises(PrbenchError, match=message):
        verified(submitted(tmp_path / "a.zip"), table(tmp_path / "other"))


def test_without_the_table_of_a_dataset_nothing_is_called_verified(tmp_path):
    other = moved_table(tmp_path / "moved", 1e-4)
    edit_json(other / "dataset.json", dataset="synthetic-gimo")
    with pytest.raises(PrbenchError, match=r"cannot be verified: still: its table of synthetic-adt is not at hand"):
        verified(submitted(tmp_path / "a.zip"), other)


@pytest.mark.parametrize(
    ("training", "said"),
    [
        (None, "not declared"),
        (declared_training(["none"]), "declared none"),
        (declared_training([DATASET]), "declared synthetic-adt (train split)"),
        (declared_training([f"{DATASET}:P0,P4"]), "overlaps 2 test recordings"),
        (declared_training([f"{DATASET}:all"]), "overlaps 4 test recordings"),
        (
            TrainingData(corpora=("AMASS",), datasets=(TrainingDataset(dataset="gimo"),)),
            "declared gimo (train split), AMASS",
        ),
    ],
)
def test_training_data_that_overlap_with_tested_recordings_are_told(tmp_path, training, said):
    assert verified(submitted(tmp_path / "a.zip", training=training)).training == said


def test_verify_tells_the_result_and_the_exit_code(tmp_path, capsys):
    file = submitted(tmp_path / "a.zip", "scripted")
    assert main(["leaderboard", "verify", str(file), "--data", str(made() / "table"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"]["training"] == "not declared"
    assert main(["leaderboard", "verify", str(file), "--data", str(moved_table(tmp_path / "moved", 3e-4))]) == 0
    assert "MPJPE m" in capsys.readouterr().out
    file = forged(tmp_path, edited_scores(thirds))
    assert main(["leaderboard", "verify", str(file), "--data", str(made() / "table")]) == 7
    assert list((tmp_path / "unpacked" / RUNS).iterdir()) == [tmp_path / "unpacked" / RUNS / "still"]
