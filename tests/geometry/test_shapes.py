"""Rays, boxes and meshes: hand-worked cases, degenerate ones, and independent oracles."""

from __future__ import annotations

import importlib.util
import sys
import warnings

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from prbench.errors import MissingExtraError, UnloadableExtraError
from prbench.geometry.shapes import Boxes, TriangleMesh, deepest, import_open3d, near_miss, ray_distances, slab_test
from tests.slow_meshes import SlowMesh

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
    assert (ray_distances(*through, *point)[0] <= 0.05).all()


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
    given = rays(((-3, 1.04, 0), (1, 0, 0)), ((-3, 1.06, 0), (1, 0, 0)), ((3, 1.04, 0), (1, 0, 0)))
    passing = near_miss(*given, *UNIT_BOX)
    np.testing.assert_allclose(passing.distance[:, 0], [0.04, 0.06, 0.04])
    np.testing.assert_allclose(passing.along[:, 0], [3, 3, -3])
    assert (ray_distances(*given, *UNIT_BOX)[0] <= 0.05).ravel().tolist() == [True, False, False]  # one looks away


def test_exactly_the_tolerance_is_near_enough() -> None:
    point = np.zeros((1, 3)), np.zeros((1, 3))
    assert (ray_distances(*rays(((-1, 0.05, 0), (1, 0, 0))), *point)[0] <= 0.05).all()


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
    assert (ray_distances(*through, *UNIT_BOX)[0] == 0.0).all()


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


def boxes(*centres, half=(0.5, 0.5, 0.5), turn=None, offsets=None) -> Boxes:
    count = len(centres)
    rotation = np.eye(3) if turn is None else turn
    return Boxes(
        np.array(centres, dtype=float).reshape(-1, 3),
        np.repeat(rotation[None], count, axis=0),
        np.repeat(np.array(half, dtype=float)[None], count, axis=0),
        np.array([0, count] if offsets is None else offsets),
    )


def test_depth_is_the_distance_to_the_nearest_side():
    one = boxes((0, 0.5, 2), half=(1.0, 0.5, 0.3))
    points = np.array([(0, 0.5, 2), (0, 0.9, 2), (0.95, 0.5, 2), (0, 0.5, 2.4), (0, 5, 0)])
    assert one.depth(points)[:, 0] == pytest.approx([0.3, 0.1, 0.05, -0.1, -4.0])


def test_a_turned_box_is_measured_along_its_own_axes():
    turn = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    turned = boxes((0, 0, 0), half=(1.0, 1.0, 0.1), turn=turn)
    along = turn @ (0.9, 0, 0)
    assert turned.depth(np.array([along, (0.9, 0, 0)]))[:, 0] == pytest.approx([0.1, 0.1 - 0.9 * np.sqrt(0.5)])


def test_moving_boxes_and_points_together_changes_no_depth():
    rng = np.random.default_rng(0)
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec((0.1, -1.1, 0.7)).as_matrix()
    transform[:3, 3] = (1.0, -2.0, 0.5)
    several = boxes((0, 0, 0), (1, 1, 1), turn=Rotation.from_rotvec((0.2, -1.1, 0.7)).as_matrix())
    points = rng.normal(size=(40, 3))
    moved = points @ transform[:3, :3].T + transform[:3, 3]
    assert several.placed(transform).depth(moved) == pytest.approx(several.depth(points))


def test_leaving_out_boxes_that_are_far_away_changes_no_depth():
    rng = np.random.default_rng(3)
    motion = rng.normal(size=(12, 22, 3))
    scene = boxes(*rng.uniform(-6, 6, size=(30, 3)), turn=Rotation.from_rotvec((0.4, -1.1, 0.7)).as_matrix())
    everything = np.maximum(scene.depth(motion.reshape(-1, 3)).max(axis=1), 0).reshape(12, 22).max(axis=1)
    assert not scene.reached(motion.reshape(-1, 3)).all()
    assert deepest(motion, scene) == pytest.approx(everything)


def test_parts_and_joins_keep_every_box_with_its_sequence():
    three = boxes((0, 0, 0), (1, 0, 0), (2, 0, 0), offsets=[0, 2, 2, 3])
    assert len(three) == 3
    assert three.part(2, 3).centre.tolist() == [[2, 0, 0]]
    assert len(three.part(1, 2).centre) == 0
    again = Boxes.joined([three.part(row, row + 1) for row in range(3)])
    assert again.offsets.tolist() == [0, 2, 2, 3]
    assert three.chosen(np.array([False, True, True])).offsets.tolist() == [0, 1, 1, 2]


def test_arrays_that_do_not_belong_together_are_refused():
    with pytest.raises(ValueError, match="offsets must rise from 0 to 1"):
        boxes((0, 0, 0), offsets=[0, 2])


FAR_AWAY = np.array([7.0, 1.5, -9.0])


SQUARE = np.array([[-1.0, -1.0, 2.0], [1.0, -1.0, 2.0], [1.0, 1.0, 2.0], [-1.0, 1.0, 2.0]])


TWO_TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)])


needs_open3d = pytest.mark.skipif(importlib.util.find_spec("open3d") is None, reason="needs the extra open3d")


def _crowd() -> tuple[np.ndarray, np.ndarray]:
    """Random triangles, several metres from the origin, where float32 is coarse."""
    return np.random.default_rng(5).normal(size=(90, 3)) + FAR_AWAY, np.arange(90).reshape(-1, 3)


@needs_open3d
def test_closest_points_are_those_of_a_slow_loop() -> None:
    points = np.random.default_rng(6).normal(size=(400, 3)) * 2 + FAR_AWAY
    corners = _crowd()[0][:20]
    points = np.concatenate([points, corners, corners + 1e-5])
    expected = SlowMesh(*_crowd()).distance(points)
    assert TriangleMesh(*_crowd()).distance(points) == pytest.approx(expected, abs=1e-6)


@needs_open3d
def test_points_outside_a_ball_are_as_far_as_from_its_surface() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=5)
    origins = np.random.default_rng(2).normal(size=(700, 3))
    origins *= 3 / np.linalg.norm(origins, axis=1, keepdims=True)
    mesh = TriangleMesh(np.array(sphere.vertices), np.array(sphere.faces))
    assert mesh.distance(origins) == pytest.approx(2.0, abs=2e-3)


def test_without_open3d_the_message_says_how_to_install_it(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"^drawing needs .*pip install 'prbench\[open3d\]'"):
        import_open3d("drawing")


def test_a_library_that_the_system_lacks_is_named(monkeypatch, tmp_path) -> None:
    """Open3D's wheel on a server without the libraries of a desktop."""
    (tmp_path / "open3d.py").write_text("raise ImportError('libusb-1.0.so.0: cannot open shared object file')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    with pytest.raises(UnloadableExtraError, match=r"libusb-1\.0\.so\.0.*apt-get install libusb-1\.0-0"):
        import_open3d("drawing")
