from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction import metrics

# A stands 1 m aside in both frames, B is 3 m off in the last one alone.
PREDICTED = np.zeros((1, 2, 2, 1, 3))
PREDICTED[0, 0, :, 0, 0] = 1.0
PREDICTED[0, 1, 1, 0, 1] = 3.0
TRUTH = np.zeros((1, 2, 1, 3))


def test_the_published_program_gives_the_same_numbers(samples):
    golden = np.load(samples / "metrics" / "stochastic_prediction.npz")
    predicted = golden["pred"].reshape(1, *golden["pred"].shape[:2], 21, 3)
    truth = golden["gt"].reshape(1, -1, 21, 3)
    found = metrics.displacements(metrics.frame_errors(predicted, truth))
    members = golden["gt_multi"].reshape(len(golden["gt_multi"]), -1, 21, 3)
    mmade, mmfde = metrics.multimodal_displacements(predicted[0], members)
    values = (found["ade"][0], found["fde"][0], mmade, mmfde, metrics.diversity(predicted)[0])
    expected = [float(golden[name]) for name in ("ade", "fde", "mmade", "mmfde", "apd")]
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-6)


def test_the_best_sample_counts_for_each_metric_by_itself():
    found = metrics.displacements(metrics.frame_errors(PREDICTED, TRUTH))
    assert (found["ade"][0], found["fde"][0]) == (1.0, 1.0)
    assert (found["ade_mean"][0], found["fde_mean"][0]) == (1.25, 2.0)
    # Backwards B ends where it should, and A has the smaller error on average.
    backwards = metrics.displacements(metrics.frame_errors(PREDICTED[:, :, ::-1], TRUTH))
    assert (backwards["ade"][0], backwards["fde"][0]) == (1.0, 0.0)


def test_diversity_is_over_the_flattened_motion():
    assert metrics.diversity(PREDICTED)[0] == pytest.approx(np.sqrt(11))
    assert metrics.diversity(PREDICTED[:, :1])[0] == 0.0


def test_futures_of_similar_pasts_are_averaged():
    members = np.stack([TRUTH[0], PREDICTED[0, 1]])
    assert metrics.multimodal_displacements(PREDICTED[0], members) == (0.5, 0.5)


def test_many_futures_are_compared_in_blocks(monkeypatch):
    rng = np.random.default_rng(0)
    predicted = rng.normal(size=(3, 5, 4, 3))
    members = rng.normal(size=(7, 5, 4, 3))
    whole = metrics.multimodal_displacements(predicted, members)
    monkeypatch.setattr(metrics, "_MOST_VALUES", 2 * predicted.size)
    assert metrics.multimodal_displacements(predicted, members) == whole


def test_a_past_at_exactly_the_threshold_is_not_similar():
    poses = np.zeros((3, 1, 3))
    poses[:, 0, 0] = (0.0, 0.5, 0.75)
    found = metrics.similar_pasts(poses, closer_than=0.5, block=2)
    assert [members.tolist() for members in found] == [[0], [1, 2], [1, 2]]


def test_standing_still_on_a_walk_has_the_error_that_one_computes_by_hand():
    frames = np.arange(1, 61)
    truth = np.zeros((1, 60, 21, 3))
    truth[0, :, :, 0] = (1.4 * frames / 30)[:, None]
    found = metrics.displacements(metrics.frame_errors(np.zeros((1, 1, 60, 21, 3)), truth))
    assert found["ade"][0] == pytest.approx(6.5225, abs=1e-4)
    assert found["fde"][0] == pytest.approx(12.8312, abs=1e-4)


def test_a_jump_and_a_longer_bone_are_measured():
    last = np.array([[[0.0, 0, 0], [0.0, 1, 0]]])
    predicted = np.array([[[[[0.3, 0, 0], [0.3, 1.1, 0]]]]])
    assert metrics.bone_error(predicted, last, [(0, 1)])[0] == pytest.approx(10.0)
    assert metrics.first_frame_jump(predicted, last)[0] == pytest.approx((0.3 + np.hypot(0.3, 0.1)) / 2)


def test_a_bone_without_length_is_left_out():
    last = np.array([[[0.0, 0, 0], [0.0, 1, 0], [0.0, 1, 0]]])
    predicted = np.array([[[[[0.0, 0, 0], [0.0, 1.1, 0], [0.0, 2, 0]]]]])
    assert metrics.bone_error(predicted, last, [(0, 1), (1, 2)])[0] == pytest.approx(10.0)


def test_the_nearer_wrist_is_measured_at_the_goal():
    wrists = np.array([[[[1.0, 0, 0], [0, 0, 3.0]], [[2.0, 0, 0], [0, 0, 4.0]]]])
    best, mean = metrics.goal_distances(wrists, np.zeros((1, 3)))
    assert (best[0], mean[0]) == (1.0, 1.5)


def test_no_samples_are_refused():
    with pytest.raises(UsageError, match="one sample"):
        metrics.displacements(np.zeros((1, 0, 3)))
