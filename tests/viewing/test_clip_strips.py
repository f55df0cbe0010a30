"""Filmstrips of clips are drawn, and every activity of synthetic people is among them."""

from __future__ import annotations

import pytest

from prbench.synthetic.activities.narrate import PATTERNS
from prbench.viewing import gallery as clip_strips
from prbench.viewing.gallery import Strip, render_strips, strips_of_activities
from tests.fakes import smooth_motion


def test_a_picture_is_written(tmp_path):
    render_strips([Strip("C sways.", smooth_motion("strip", 40), 20.0)] * 3, tmp_path / "strips.png")
    assert (tmp_path / "strips.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="at least one clip"):
        render_strips([], tmp_path / "none.png")


def test_strips_show_one_clip_of_each_activity(monkeypatch):
    monkeypatch.setattr(clip_strips, "_RECORDINGS", 4)
    names = [strip.text.split("]")[0].removeprefix("[") for strip in strips_of_activities(2)]
    assert names == sorted(set(names))
    assert set(names) <= set(PATTERNS)
    assert len(names) > 10
