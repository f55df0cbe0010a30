"""Z up to Y up: one quarter turn, as points and as matrix."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, transform_points, y_up, z_up

POINTS = np.random.default_rng(3).normal(size=(4, 5, 3))


def test_what_was_up_is_up_and_nothing_is_mirrored() -> None:
    np.testing.assert_array_equal(y_up(np.array([1.0, 2.0, 3.0])), [1.0, 3.0, -2.0])
    assert np.linalg.det(Y_UP_FROM_Z_UP[:3, :3]) == pytest.approx(1.0)


def test_points_and_matrix_are_the_same_turn() -> None:
    np.testing.assert_array_equal(y_up(POINTS), transform_points(Y_UP_FROM_Z_UP, POINTS))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_there_and_back_changes_no_bit(kind) -> None:
    points = POINTS.astype(kind)
    assert z_up(y_up(points)).dtype == kind
    np.testing.assert_array_equal(z_up(y_up(points)), points)
