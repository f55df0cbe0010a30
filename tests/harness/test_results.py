"""Entries of a stored summary are compared with what follows from the scores."""

from __future__ import annotations

import msgspec
import pytest

from prbench.harness.results import differences, tree_of
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
