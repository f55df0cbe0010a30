"""Scores of predictors and references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction.batch import Condition, ask
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity, NearestPast, ZeroVelocity
from prbench_benchmarks.motion_prediction.scoring import (
    SimilarPasts,
    ground_truth,
    references,
    score_predictor,
    score_reference,
    truncation_floor,
)
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction import windows
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


@pytest.fixture(scope="module")
def walks(tmp_path_factory) -> WindowsTable:
    return WindowsTable.open(windows.write(tmp_path_factory.mktemp("windows") / "w"))


def question(walks, condition=Condition.POSE, split="test", **options):
    return next(walks.batches(condition, walks.chosen(split=split), **options))


def test_zero_velocity_holds_the_last_pose(walks):
    batch, _ = question(walks)
    futures = ask(ZeroVelocity(), batch, n_samples=2, seed=0)
    assert (futures.joints == batch.observed_joints[:, None, -1:]).all()


def test_constant_velocity_goes_on_as_it_was(walks):
    batch, _ = question(walks)
    futures = ask(ConstantVelocity(), batch, n_samples=1, seed=0).joints[:, 0]
    step = batch.observed_joints[:, -1] - batch.observed_joints[:, -2]
    np.testing.assert_allclose(futures[:, 9] - batch.observed_joints[:, -1], 10 * step, atol=1e-5)


@pytest.mark.parametrize("condition", list(Condition))
@pytest.mark.parametrize("frame", ["room", "last-pose"])
def test_the_nearest_past_of_a_window_that_was_learnt_is_its_own(walks, condition, frame):
    predictor = NearestPast().remember(walks.batches(condition, walks.chosen(split="train")))
    batch, truth = question(walks, condition, "train", frame=frame)
    futures = ask(predictor, batch, n_samples=3, seed=0)
    np.testing.assert_allclose(futures.joints[:, 0], truth.joints, atol=1e-5)
    fewer = ask(predictor, batch, n_samples=2, seed=0)
    np.testing.assert_array_equal(fewer.joints, futures.joints[:, :2])


def test_the_nearest_past_cannot_give_more_samples_than_it_saw(walks):
    predictor = NearestPast().remember(walks.batches(Condition.POSE, walks.chosen(split="train")))
    with pytest.raises(UsageError, match="at most 5 samples, found 6"):
        ask(predictor, question(walks)[0], n_samples=6, seed=0)


def test_scores_do_not_depend_on_the_frame_or_the_batch(walks):
    chosen = walks.chosen()
    similar = SimilarPasts.of(walks, chosen, closer_than=0.4)
    scored = [
        score_predictor(
            ConstantVelocity(), walks, Condition.POSE, chosen, similar=similar, n_samples=2, frame=frame, size=size
        ).columns
        for frame, size in (("room", 4), ("last-pose", 5))
    ]
    assert list(scored[0]) == list(scored[1])
    for name in scored[0]:
        values = [each[name] for each in scored]
        if isinstance(values[0][0], str):
            assert values[0] == values[1]
        else:
            np.testing.assert_allclose(values[0], values[1], atol=2e-5)


def test_every_window_is_similar_to_itself_and_its_own_future_counts(walks):
    chosen = walks.chosen()
    similar = SimilarPasts.of(walks, chosen, closer_than=1e-9)
    scores = score_predictor(ZeroVelocity(), walks, Condition.POSE, chosen, similar=similar, n_samples=1)
    assert scores.columns["similar_pasts"] == [1.0] * len(chosen)
    np.testing.assert_allclose(scores.columns["mmade"], scores.columns["ade"], atol=1e-5)
    np.testing.assert_allclose(scores.columns["mmfde_canonical"], scores.columns["fde"], atol=1e-5)


def test_smaller_numbers_of_samples_are_scored_as_prefixes(walks):
    scores = score_predictor(ZeroVelocity(), walks, Condition.POSE, walks.chosen(), n_samples=1)
    assert scores.means()["ade@k1"] == pytest.approx(np.mean(scores.columns["ade"]))
    assert "ade@k5" not in scores.columns


def test_no_samples_are_refused(walks):
    with pytest.raises(UsageError, match="one sample"):
        score_predictor(ZeroVelocity(), walks, Condition.POSE, walks.chosen(), n_samples=0)
