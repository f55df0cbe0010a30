"""Errors of reconstructed motions: the public program's values and cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench_benchmarks.motion_tokens.metrics import aligned, error_sums, pooled

CORNERS = np.vstack([np.zeros(3), np.eye(3)])[None]


def test_the_values_of_the_public_program(samples):
    golden = np.load(samples / "nymeria-tasks" / "tracking_metrics.npz")
    sums = [error_sums(golden[f"pred_{i}"], golden[f"gt_{i}"]) for i in range(2)]
    np.testing.assert_allclose([pooled([each]) for each in sums], golden["recon_rows"], rtol=0, atol=1e-4)
    np.testing.assert_allclose(pooled(sums), golden["recon_all"], rtol=0, atol=1e-4)


def test_a_stretched_corner_worked_by_hand():
    longer = CORNERS.copy()
    longer[0, 3, 2] = 2.0
    frames = [np.repeat(each, 3, axis=0) for each in (longer, CORNERS)]
    mpjpe, pa_mpjpe, acc = pooled([error_sums(*frames)])
    assert mpjpe == pytest.approx(250.0)
    assert pa_mpjpe == pytest.approx(227.832, abs=1e-3)
    assert acc == pytest.approx(0.0, abs=1e-9)
    centred = [each - each.mean(axis=1, keepdims=True) for each in (aligned(longer, CORNERS), longer)]
    assert np.divide(*(np.linalg.norm(each) for each in centred)) == pytest.approx(0.673558, abs=1e-6)


def test_any_turned_scaled_and_shifted_copy_has_no_error_after_alignment_and_a_mirrored_one_has():
    points = np.random.default_rng(0).normal(size=(3, 22, 3))
    copy = 0.4 * points @ Rotation.from_rotvec([0.3, 2.0, -1.0]).as_matrix() + [1.0, 2.0, 3.0]
    assert error_sums(copy, points)[1, 0] == pytest.approx(0.0, abs=1e-9)
    assert error_sums(copy * [-1.0, 1.0, 1.0], points)[1, 0] > 100.0


def test_a_mirrored_body_is_aligned_as_well_as_turning_can():
    generator = np.random.default_rng(1)
    fixed = generator.normal(size=(22, 3))
    moved = fixed * [-1.0, 1.0, 1.0] + 0.1 * generator.normal(size=(22, 3))
    centres = fixed.mean(axis=0), moved.mean(axis=0)
    rotation, _ = Rotation.align_vectors(fixed - centres[0], moved - centres[1])
    turned = rotation.apply(moved - centres[1])
    scale = np.sum(turned * (fixed - centres[0])) / np.sum(turned**2)
    np.testing.assert_allclose(aligned(moved[None], fixed[None])[0], scale * turned + centres[0], atol=1e-9)


def test_points_that_are_all_one_are_aligned_too():
    assert np.isfinite(aligned(np.zeros_like(CORNERS), CORNERS)).all()


def test_frames_of_all_sequences_count_alike_and_acc_has_two_fewer():
    still = np.zeros((3, 22, 3))
    sums = error_sums(still + np.eye(22, 1)[:, 0, None] * [0.022, 0.0, 0.0], still)
    # The pelvis is 22 mm off, so all others are, seen from it.
    assert sums[0].tolist() == pytest.approx([3 * 21.0, 3])
    assert sums[2].tolist() == [0.0, 1]
    long = np.array([[0.0, 30.0], [0.0, 30.0], [0.0, 28.0]])
    assert pooled([sums, long])[0] == pytest.approx(63.0 / 33)


def test_acc_is_the_second_difference_of_the_global_error():
    still = np.zeros((4, 22, 3))
    moved = still.copy()
    moved[2, :, 0] = 0.001
    assert pooled([error_sums(moved, still)])[2] == pytest.approx((1.0 + 2.0) / 2)
