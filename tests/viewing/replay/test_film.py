"""The film: length, size, real time, and that what moves moves."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import StorageError
from prbench.viewing.replay import film
from prbench.viewing.replay.film import FPS, SIZE, FilmStage, film_scenes, shown_frames
from tests.viewing.replay.scenes import a_scene

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")


def _picture(stage: FilmStage, frame: int) -> np.ndarray:
    return np.frombuffer(stage.picture(frame), dtype=np.uint8).reshape(SIZE[1], SIZE[0], 3)


def test_the_film_has_every_frame_at_real_time_and_holds_the_last(tmp_path):
    path, told = tmp_path / "view.mp4", []
    scene = a_scene("static, none", n_frames=12)
    film_scenes([scene], path, lambda *step: told.append(step[:2]))
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    assert about["size"] == SIZE
    assert about["fps"] == FPS
    assert about["codec"] == "h264"
    pictures = [np.frombuffer(picture, dtype=np.uint8).astype(int) for picture in reader]
    assert len(pictures) == 12 + FPS == told[-1][1] == len(told)
    assert np.abs(pictures[0] - pictures[11]).max() > 100, "the body has moved"
    assert np.abs(pictures[12] - pictures[-1]).mean() < 1, "the last frame stays"


def test_the_same_scenes_give_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(film, "_HOLD", 0.1)
    for name in ("one.mp4", "two.mp4"):
        film_scenes([a_scene(n_frames=3)], tmp_path / name, lambda *_: None)
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "two.mp4").read_bytes()


@pytest.mark.parametrize("fps", [20.0, 30.0, 60.0])
def test_any_rate_plays_in_real_time(fps):
    n_frames = int(3 * fps) + 1
    scene = a_scene(n_frames=n_frames, fps=fps)
    moving = shown_frames(scene)[:-FPS]
    assert len(moving) == 3 * FPS + 1
    np.testing.assert_allclose(moving / fps, np.arange(len(moving)) / FPS, atol=0.5 / fps + 1e-9)


def test_a_picture_does_not_depend_on_those_before_it():
    scene = a_scene("static, none")
    jumping = FilmStage(scene)
    jumping.picture(0)
    assert (_picture(jumping, 40) == _picture(FilmStage(scene), 40)).all()


def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        film_scenes([a_scene(n_frames=3)], tmp_path / "file" / "a.mp4", lambda *_: None)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]
