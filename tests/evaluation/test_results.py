"""Entries of a stored summary are compared with what follows from the scores."""

from __future__ import annotations

import msgspec
import pytest

from prbench.evaluation.results import metric_differences
from prbench.runs.summary import MetricSummary


@pytest.mark.parametrize(("low", "differs"), [(0.2, False), (0.206, False), (0.22, True), (0.0, True)])
def test_intervals_that_0_5_0_drew_are_no_edits(low: float, differs: bool) -> None:
    entry = MetricSummary(
        metric="mpjpe", title="MPJPE", unit="m", mean=0.25, low=0.2, high=0.3, level=0.95, interval="bootstrap",
        sequences=48, recordings=12, marks=(), flags={},
    )  # fmt: skip
    found = list(metric_differences(entry, msgspec.structs.replace(entry, low=low)))
    assert found == ([("mpjpe.low", 0.2, low)] if differs else [])
