"""Closest points on meshes, against a loop over all triangles."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest
import trimesh

from prbench.errors import MissingExtraError, UnloadableExtraError
from prbench.geometry.shapes import TriangleMesh, import_open3d
from tests.slow_meshes import SlowMesh

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


@needs_open3d
def test_no_points_have_no_distances() -> None:
    mesh = TriangleMesh(SQUARE, TWO_TRIANGLES)
    assert mesh.distance(np.empty((0, 3))).shape == (0,)


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
