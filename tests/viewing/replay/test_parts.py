"""Points on what stood around, behind the bodies of every kind of view."""

from __future__ import annotations

import dataclasses

import matplotlib.image
import numpy as np

from prbench.viewing.replay.film import FilmStage
from prbench.viewing.replay.page import write_page
from prbench.viewing.replay.scene import SLICE, SURROUNDINGS_COLOUR, beside, rgb
from prbench.viewing.replay.sheet import draw_sheet
from tests.viewing.replay.scenes import a_scene

WALL = np.random.default_rng(0).uniform([-0.3, 0.1, -0.5], [0.3, 1.5, 2.5], (8000, 3))


def _grey(pixels: np.ndarray) -> int:
    return int((np.abs(pixels.astype(int) - rgb(SURROUNDINGS_COLOUR)).max(axis=-1) < 12).sum())


def test_a_side_view_shows_a_slice_around_the_body() -> None:
    axis = np.array([0.0, 0.0, 1.0])
    points = np.array([[0.0, 9.0, 0.5], [0.0, 1.0, 0.7], [SLICE + 0.01, 1.0, 0.0], [0.1 - SLICE, 1.0, -0.5]])
    ground = np.array([4.0, 0.0, 2.0])
    found = beside(points + ground, np.array([4.0, 1.0, 2.0]), axis, reach=0.6)
    np.testing.assert_allclose(found - ground, points[[0, 3]], atol=1e-12)


def test_a_sheet_and_a_film_show_the_points(tmp_path) -> None:
    plain = a_scene("static, none")
    scene = dataclasses.replace(plain, surroundings=WALL)
    greys = []
    for each in (plain, scene):
        draw_sheet([each], tmp_path / "a.png")
        greys.append(_grey((matplotlib.image.imread(tmp_path / "a.png")[..., :3] * 255).round()))
    assert greys[1] > greys[0] + 2000
    films = [np.frombuffer(FilmStage(each, (1280, 720)).picture(0), np.uint8) for each in (plain, scene)]
    assert _grey(films[1].reshape(-1, 3)) > _grey(films[0].reshape(-1, 3)) + 2000


def test_a_page_holds_the_points_once(tmp_path) -> None:
    pages = {}
    for name, points in (("plain", None), ("around", WALL)):
        scene = dataclasses.replace(a_scene("static, none", n_frames=3), surroundings=points)
        write_page([scene], tmp_path / f"{name}.html", lambda *_: None)
        pages[name] = (tmp_path / f"{name}.html").stat().st_size
    assert pages["plain"] < pages["around"] < pages["plain"] + 2 * WALL.nbytes
