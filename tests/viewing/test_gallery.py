"""The pictures of synthetic people: that they are written, and that what they plot is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance
from prbench.viewing.gallery import Scene, curves_of, render_gallery, sequences_of


@pytest.fixture(scope="module")
def performance() -> Performance:
    return perform("mogaze", seed=4, index=0, n_events=3, rate=60.0, provocations={})


def png_size(path: Path) -> tuple[int, int]:
    header = path.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(header[16:20], "big"), int.from_bytes(header[20:24], "big")


def test_a_sheet_has_a_cell_for_every_scene(performance: Performance, tmp_path: Path) -> None:
    scenes = sequences_of([performance])
    assert len(scenes) >= 2
    render_gallery(scenes[:2], tmp_path / "two.png", columns=2, dpi=30)
    render_gallery(scenes[:1], tmp_path / "one.png", columns=2, dpi=30)
    wide, narrow = png_size(tmp_path / "two.png"), png_size(tmp_path / "one.png")
    assert wide == (2 * narrow[0], narrow[1])


def test_the_same_scenes_give_the_same_bytes(performance: Performance, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        render_gallery(sequences_of([performance])[:1], tmp_path / name, dpi=30)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_events_that_never_become_sequences_can_be_drawn_too(performance: Performance, tmp_path: Path) -> None:
    unseen = replace(performance.events[0], prime_time=None, prime_kind=None, expected="not_primed")
    render_gallery([Scene(performance, unseen)], tmp_path / "unseen.png", dpi=30)
    assert png_size(tmp_path / "unseen.png")[0] > 0


def test_an_empty_gallery_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one scene"):
        render_gallery([], tmp_path / "none.png")


def test_curves_start_at_the_scene_and_end_at_the_event(performance: Performance) -> None:
    scene = sequences_of([performance])[0]
    curves = curves_of(performance, scene.event, scene.start, scene.end)
    assert curves.times[0] == pytest.approx(scene.start - scene.end, abs=0.03)
    assert curves.times[-1] == pytest.approx(0.0, abs=0.03)
    assert curves.wrist_distance[-1] < 0.13  # the hand holds the object
    frame = int(np.searchsorted(performance.times, scene.start))
    assert curves.pelvis_height[0] == performance.joints[frame, Joint.PELVIS, 1]


def test_gaze_that_looks_straight_at_the_goal_has_no_distance_and_away_the_full_one(performance: Performance) -> None:
    event = performance.events[0]
    sight = event.goal - performance.eye
    towards = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    for sign, expected in ((1.0, np.zeros(len(sight))), (-1.0, np.linalg.norm(sight, axis=1))):
        curves = curves_of(replace(performance, gaze=sign * towards), event, 1.0, 2.0)
        frames = np.searchsorted(performance.times, curves.times + event.event_time - 1e-9)
        assert curves.gaze_distance == pytest.approx(expected[frames], abs=1e-6)
