"""Stored scores and summaries are compared with what follows from motions and scores."""

from __future__ import annotations

import msgspec
import pyarrow as pa
import pytest

from prbench.errors import RunError
from prbench.harness.results import differences, require_scores, tree_of
from prbench.harness.run_folder.folder import DatasetFolder
from prbench.harness.run_folder.scores import SCORES, CodedScores
from prbench.harness.run_folder.summary import DatasetSummary, MetricSummary

ENTRY = MetricSummary(
    metric="mpjpe", title="MPJPE", unit="m", mean=0.25, low=0.2, high=0.3, level=0.95, interval="student-hall-cluster",
    sequences=48, recordings=12, marks=(), flags={},
)  # fmt: skip


def tree(entry: MetricSummary) -> dict[str, object]:
    summary = DatasetSummary(
        dataset="adt", title="ADT", synthetic=False, redistribution="none", method="pr", condition="text", control=None,
        split="test", sequences=48, unsupported=0, recordings=12, samples=1, length_mismatches=0, metrics=(entry,),
    )  # fmt: skip
    return tree_of(summary)


# Bounds of 0.206 passed here while version 0.5.0 drew its bootstrap; no bound is drawn any more.
@pytest.mark.parametrize(("low", "differs"), [(0.2, False), (0.2 + 1e-8, False), (0.206, True), (0.0, True)])
def test_bounds_follow_from_the_scores(low: float, differs: bool) -> None:
    found = list(differences(tree(ENTRY), tree(msgspec.structs.replace(ENTRY, low=low))))
    assert found == ([("mpjpe.low", 0.2, low)] if differs else [])


def test_another_estimator_is_named_before_its_bounds() -> None:
    stored = msgspec.structs.replace(ENTRY, low=0.21, interval="bootstrap")
    assert next(differences(tree(ENTRY), tree(stored)))[0] == "mpjpe.interval"


def coded(*values: float, **changes: object) -> CodedScores:
    rows = [{"sequence_id": str(i), "dataset": "d", "sample": 0, "metric": "mpjpe", "value": value} | changes
            for i, value in enumerate(values)]  # fmt: skip
    return CodedScores.of([pa.Table.from_pylist(rows, schema=SCORES)])


@pytest.mark.parametrize(
    ("made", "stored", "message"),
    [
        (0.25, 0.25 + 0.9e-6, ""),  # other processors round another way
        (0.25, 0.25 + 1.2e-6, "row 1 .1, sample 0, mpjpe.: expected 0.25, .* found 0.250001 .1 of 2 values differ."),
        (0.25, 0.252, "found 0.252"),
        (0.25, 0.25 - 1.2e-6, "found 0.249999"),
        (1000.0, 1000.0009, ""),
        (1000.0, 1000.0011, "found 1000"),
        (0.25, float("nan"), "found nan"),
        (float("nan"), 0.25, "expected nan"),
    ],
)
def test_scores_differ_by_less_than_a_millionth_from_those_of_the_motions(tmp_path, made, stored, message) -> None:
    if not message:
        require_scores(DatasetFolder(tmp_path), coded(0.5, stored), coded(0.5, made))
        return
    with pytest.raises(RunError, match=message):
        require_scores(DatasetFolder(tmp_path), coded(0.5, stored), coded(0.5, made))


@pytest.mark.parametrize(
    ("stored", "message"),
    [
        (coded(0.5, 0.25, metric="goal_mpjpe"), "row 0: expected 0, sample 0, mpjpe from .* found 0, sample 0, goal_m"),
        (coded(0.5, 0.25, flag="x"), "row 0: expected 0, sample 0, mpjpe from .* found 0, sample 0, mpjpe, x .2 and 2"),
        (coded(0.5, 0.25, sample=1), "found 0, sample 1, mpjpe"),
        (coded(0.5), r"row 1: expected 1, sample 0, mpjpe from .* found no row \(2 and 1 rows\)"),
        (coded(0.5, 0.25, 0.1), "row 2: expected no row from the motions and their table, found 2, sample 0, mpjpe"),
    ],
)
def test_scores_have_the_rows_of_the_motions(tmp_path, stored, message) -> None:
    with pytest.raises(RunError, match=message):
        require_scores(DatasetFolder(tmp_path), stored, coded(0.5, 0.25))
