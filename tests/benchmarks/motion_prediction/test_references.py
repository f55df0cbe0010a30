from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.scoring import (
    SimilarPasts,
    ground_truth,
    references,
    score_reference,
    truncation_floor,
)
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction.windows import walking, write


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return WindowsTable.open(write(tmp_path_factory.mktemp("windows") / "w"))


def _straight(n):
    run = walking("straight", n)
    path = np.arange(n)[:, None, None] * np.array([1.4 / run.fps, 0.0, 0.0])
    return replace(run, joints=run.joints[:1] + path)


def test_the_ground_truth_has_no_error(table):
    chosen = table.chosen()
    similar = SimilarPasts.of(table, chosen, closer_than=0.4)
    means = score_reference(ground_truth, table, chosen, similar=similar).means()
    # The batch holds float32 positions.
    assert means["ade"] == pytest.approx(0.0, abs=1e-5)
    assert means["mmfde"] == pytest.approx(0.0, abs=1e-5)


def test_ten_coefficients_of_a_walk_at_1_4_m_s_end_5_cm_beside_it(tmp_path):
    table = WindowsTable.open(write(tmp_path / "w", _straight(91)))
    means = score_reference(truncation_floor(10), table, table.chosen()).means()
    # 0.74 cm and 4.94 cm a joint: the figures of an independent calculation (docs/specification/motion-prediction.md).
    assert means["ade"] == pytest.approx(0.0074 * np.sqrt(22), rel=0.01)
    assert means["fde"] == pytest.approx(0.0494 * np.sqrt(22), rel=0.01)


def test_all_coefficients_leave_nothing_out(table):
    batch, truth = next(table.batches(Condition.POSE, table.chosen()))
    futures = truncation_floor(75)(batch, truth)
    assert np.allclose(futures.joints[:, 0], truth.joints, atol=1e-5)


def test_references_are_no_methods_of_one_sample_more(table):
    batch, truth = next(table.batches(Condition.POSE, table.chosen()))
    for reference in references().values():
        assert reference(batch, truth).joints.shape == (len(batch), 1, 60, 22, 3)
