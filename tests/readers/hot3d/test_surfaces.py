"""Points spread over meshes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from prbench.readers.hot3d.surfaces import surface_points

TRIANGLE = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.02, 0.07, 0]])


def test_no_place_of_a_triangle_is_far_from_a_point() -> None:
    points = surface_points(TRIANGLE, np.array([[0, 1, 2]]), spacing=0.003)
    weights = np.random.default_rng(0).dirichlet(np.ones(3), 2000)
    distance, _ = KDTree(points).query(weights @ TRIANGLE)
    assert distance.max() <= 0.003 / np.sqrt(3) + 1e-9


def test_points_lie_on_the_triangle_and_hold_its_corners() -> None:
    points = surface_points(TRIANGLE, np.array([[0, 1, 2]]), spacing=0.01)
    assert points[:, 2] == pytest.approx(np.zeros(len(points)))
    corners = np.vstack([TRIANGLE.T[:2], np.ones(3)])
    weights = np.linalg.solve(corners, np.vstack([points.T[:2], np.ones(len(points))]))
    assert weights.min() >= -1e-9
    assert KDTree(points).query(TRIANGLE)[0] == pytest.approx(np.zeros(3))


def test_what_two_triangles_share_counts_once() -> None:
    square = np.array([[0.0, 0, 0], [0.03, 0, 0], [0.03, 0.03, 0], [0.0, 0.03, 0]])
    points = surface_points(square, np.array([[0, 1, 2], [0, 2, 3]]), spacing=0.0425)
    assert len(points) == 4
    fine = surface_points(square, np.array([[0, 1, 2], [0, 2, 3]]), spacing=0.01)
    assert KDTree(fine).query(fine, k=2)[0][:, 1].min() > 0.002


def test_a_scan_of_small_triangles_keeps_its_corners_only() -> None:
    small = TRIANGLE / 50
    assert len(surface_points(small, np.array([[0, 1, 2]]), spacing=0.003)) <= 3
