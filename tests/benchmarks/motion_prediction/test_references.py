from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.folds import default_split, folds
from prbench_benchmarks.motion_prediction.references import ground_truth, references, score_reference, truncation_floor
from prbench_benchmarks.motion_prediction.scoring import SimilarPasts
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


def test_no_coefficients_are_refused():
    with pytest.raises(UsageError, match="one coefficient"):
        truncation_floor(0)


def test_references_are_no_methods_of_one_sample_more(table):
    batch, truth = next(table.batches(Condition.POSE, table.chosen()))
    for reference in references().values():
        assert reference(batch, truth).joints.shape == (len(batch), 1, 60, 22, 3)


def test_everybody_is_left_out_once(table):
    found = list(folds(table, "participants"))
    assert [fold.name for fold in found] == ["P0", "P1"]
    for fold in found:
        assert not set(fold.train) & set(fold.test)
    assert np.array_equal(np.sort(np.concatenate([fold.test for fold in found])), table.chosen())


def test_the_split_of_the_dataset_stands_where_no_study_has_one(table):
    assert default_split(table) == "dataset"
    (fold,) = folds(table, "dataset")
    assert np.array_equal(fold.test, table.chosen(split="test"))
    assert np.array_equal(fold.train, table.chosen(split="train"))


def test_a_single_participant_cannot_be_left_out(tmp_path):
    table = WindowsTable.open(write(tmp_path / "w", walking("a", 120)))
    with pytest.raises(UsageError, match="two participants"):
        next(folds(table, "participants"))
