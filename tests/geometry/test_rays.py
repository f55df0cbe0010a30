"""Slab test and near miss: hand-worked rays, degenerate boxes and directions, and independent oracles."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from prbench.geometry.shapes import near_miss, slab_test

UNIT_BOX = (np.array([[-1.0, -1.0, -1.0]]), np.array([[1.0, 1.0, 1.0]]))


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def rays(*pairs) -> tuple[np.ndarray, np.ndarray]:
    origins, directions = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def random_scene(seed: int, n: int = 40, m: int = 30):
    rng = np.random.default_rng(seed)
    origins, directions = rng.uniform(-3, 3, (n, 3)), rng.normal(size=(n, 3))
    directions[::5, 0] = 0.0
    directions[::7, 1:] = 0.0
    directions[directions.any(axis=1) == 0] = (0, 0, 1.0)
    corner, size = rng.uniform(-3, 3, (m, 3)), rng.uniform(0.3, 4, (m, 3))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True), corner, corner + size


def test_distances_to_entry_and_exit() -> None:
    hits = slab_test(*rays(((0, 0, -3), (0, 0, 1)), ((0, 0, 0), (1, 0, 0)), ((0, 0, 3), (0, 0, 1))), *UNIT_BOX)
    assert hits.near[:, 0].tolist() == [2, -1, -4]
    assert hits.far[:, 0].tolist() == [4, 1, -2]
    assert hits.hit[:, 0].tolist() == [True, True, False]  # from outside, from inside, behind the origin


def test_a_diagonal_ray_past_the_edge_misses() -> None:
    hits = slab_test(
        *rays(((-2, -0.9, 0), (1, 1, 0)), ((-3, 0, 0), (1, 1, 0)), ((-3, -1.1, 0), (1, 1.0, 0))), *UNIT_BOX
    )
    assert hits.hit[:, 0].tolist() == [True, False, True]


def test_a_direction_component_of_zero_constrains_only_from_outside() -> None:
    inside, border, outside = ((0.5, 0, -3), (0, 0, 1)), ((1.0, 0, -3), (0, 0, 1)), ((1.001, 0, -3), (-0.0, 0, 1))
    assert slab_test(*rays(inside, border, outside), *UNIT_BOX).hit[:, 0].tolist() == [True, True, False]


def test_a_flat_box_is_hit_in_its_plane_and_a_point_never() -> None:
    flat = np.array([[-1.0, 0.0, -1.0]]), np.array([[1.0, 0.0, 1.0]])
    assert slab_test(*rays(((-3, 0, 0), (1, 0, 0))), *flat).hit.all()
    assert not slab_test(*rays(((0, 3, 0), (0, -1, 0))), *flat).hit.any()  # enters and leaves at one instant
    point = np.zeros((1, 3)), np.zeros((1, 3))
    through = rays(((0, 0, -3), (0, 0, 1)), ((-1, -1, -1), (1, 1, 1)))
    assert not slab_test(*through, *point).hit.any()
    assert near_miss(*through, *point).within(0.05).all()


@pytest.mark.parametrize("seed", range(5))
def test_hits_agree_with_a_search_along_the_ray(seed: int) -> None:
    origins, directions, low, high = random_scene(seed)

    def distance(t: np.ndarray) -> np.ndarray:
        """From the points at t (n, m) to the boxes; convex in t."""
        points = origins[:, None] + t[..., None] * directions[:, None]
        return np.linalg.norm(points - np.clip(points, low, high), axis=-1)

    left, right = np.zeros((len(origins), len(low))), np.full((len(origins), len(low)), 20.0)
    for _ in range(120):
        a, b = left + (right - left) / 3, right - (right - left) / 3
        nearer_a = distance(a) <= distance(b)
        left, right = np.where(nearer_a, left, a), np.where(nearer_a, b, right)
    closest = distance((left + right) / 2)
    hits = slab_test(origins, directions, low, high)
    found = closest < 1e-9
    clear = found | (closest > 1e-6)
    assert clear.mean() > 0.99
    assert (hits.hit == found)[clear].all()
    assert 20 < hits.hit.sum() < hits.hit.size - 20
    ray, box = np.nonzero(hits.hit)
    entry = origins[ray] + np.maximum(hits.near[hits.hit], 0)[:, None] * directions[ray]
    np.testing.assert_allclose(entry, np.clip(entry, low[box], high[box]), atol=1e-12)


def test_near_miss_worked_by_hand() -> None:
    passing = near_miss(
        *rays(((-3, 1.04, 0), (1, 0, 0)), ((-3, 1.06, 0), (1, 0, 0)), ((3, 1.04, 0), (1, 0, 0))), *UNIT_BOX
    )
    np.testing.assert_allclose(passing.distance[:, 0], [0.04, 0.06, 0.04])
    np.testing.assert_allclose(passing.along[:, 0], [3, 3, -3])
    assert passing.within(0.05)[:, 0].tolist() == [True, False, False]  # the last one looks away


def test_exactly_the_tolerance_is_near_enough() -> None:
    point = np.zeros((1, 3)), np.zeros((1, 3))
    assert near_miss(*rays(((-1, 0.05, 0), (1, 0, 0))), *point).within(0.05).all()


def test_the_miss_is_measured_towards_the_centre_not_to_the_surface() -> None:
    # Closest point (1.5, 1.2, 0) of a ray along Z; towards the centre the box is entered at x = 1: a third of the way.
    passing = near_miss(*rays(((1.5, 1.2, -3), (0, 0, 1))), *UNIT_BOX)
    assert passing.distance[0, 0] == pytest.approx(np.hypot(1.5, 1.2) / 3)


def test_a_ray_through_the_centre_or_the_box_is_at_distance_zero() -> None:
    through = rays(
        ((0, 0, -3), (0, 0, 1)), ((0.3, 0.2, -3), (0, 0, 1)), ((-3, -3, -3), (1, 1, 1)), ((0, 0, 0), (0, 1, 0))
    )
    passing = near_miss(*through, *UNIT_BOX)
    assert (passing.distance == 0).all()
    assert passing.within(0.0).all()


@pytest.mark.parametrize("seed", range(5))
def test_near_misses_agree_with_a_walk_towards_the_centre(seed: int) -> None:
    origins, directions, low, high = random_scene(seed, n=15, m=12)
    passing = near_miss(origins, directions, low, high)
    for i, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        for j, (a, b) in enumerate(zip(low, high, strict=True)):
            centre = (a + b) / 2
            closest = origin + ((centre - origin) @ direction) * direction
            walk = closest + np.linspace(0, 1, 20_001)[:, None] * (centre - closest)
            first_inside = np.flatnonzero(((walk >= a) & (walk <= b)).all(axis=1))[0]
            assert passing.distance[i, j] == pytest.approx(np.linalg.norm(walk[first_inside] - closest), abs=5e-4)


@pytest.mark.parametrize("seed", range(3))
def test_moving_the_world_moves_nothing_else(seed: int) -> None:
    origins, directions, low, high = random_scene(seed)
    shift = np.array([3.0, -2.0, 5.0])
    before, after = (
        slab_test(origins, directions, low, high),
        slab_test(origins + shift, directions, low + shift, high + shift),
    )
    assert (before.hit == after.hit).mean() > 0.999
    misses = (
        near_miss(origins, directions, low, high),
        near_miss(origins + shift, directions, low + shift, high + shift),
    )
    np.testing.assert_allclose(misses[0].distance, misses[1].distance, atol=1e-9)
    np.testing.assert_allclose(misses[0].along, misses[1].along, atol=1e-9)


def test_every_combination_is_finite_and_shaped_rays_by_boxes() -> None:
    corners = np.array([[0.0, 0, 0], [-1, 0, 0], [0, 0, -2], [1e-300, 0, 0]])
    sizes = np.array([[0.0, 0, 0], [2, 0, 0], [1, 1, 4], [0, 0, 0]])
    through = rays(((0, 0, 0), (1, 0, 0)), ((0, 0, 0), (0, 0, -1)), ((5, 0, 0), (-1, 0, 0)), ((1, 2, 3), (1, 1, 0)))
    passing, hits = near_miss(*through, corners, corners + sizes), slab_test(*through, corners, corners + sizes)
    assert passing.distance.shape == hits.hit.shape == (4, 4)
    assert np.isfinite(passing.distance).all()
    assert np.isfinite(passing.along).all()
    assert not np.isnan([hits.near, hits.far]).any()


def test_no_rays_or_no_boxes_give_empty_results() -> None:
    none, one = np.empty((0, 3)), np.ones((1, 3))
    assert slab_test(none, none, one, one).hit.shape == (0, 1)
    assert near_miss(one, one, none, none).distance.shape == (1, 0)
