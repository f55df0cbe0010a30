"""The picture: what stands in it, that nothing overlaps, and that the same scenes give the same bytes."""

from __future__ import annotations

import itertools

import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from prbench.errors import StorageError
from prbench.geometry.skeleton import Joint
from prbench.viewing.figures import body_lines, styled
from prbench.viewing.replay.scene import GAZE_COLOUR, GOAL_COLOUR, METHOD_COLOURS, RECORDED_COLOUR, rgb
from prbench.viewing.replay.sheet import (
    COLUMN,
    KEY,
    Block,
    block_height,
    chosen_frames,
    draw_key,
    draw_scene,
    draw_sheet,
)
from tests.viewing.replay.scenes import a_scene

LABELS = [f"method_with_a_name_{number}, goal-loc, shuffled-goal" for number in range(6)]


@styled
def _drawn(scene) -> Figure:
    height = block_height(len(scene.motions)) + KEY
    figure = Figure(figsize=(COLUMN, height))
    FigureCanvasAgg(figure)
    draw_scene(Block(figure, 0.0, height), scene)
    draw_key(Block(figure, 0.0, KEY), [scene])
    return figure


@pytest.mark.parametrize("n_methods", [0, 2, 6])
def test_no_text_meets_another_or_leaves_the_picture(n_methods, monkeypatch):
    figure, boxes = _drawn(a_scene(*LABELS[:n_methods])), []
    draw = Text.draw

    def noting(self, renderer, *arguments, **options):
        if self.get_visible() and self.get_text().strip():
            boxes.append((self.get_text(), self.get_window_extent(renderer)))
        draw(self, renderer, *arguments, **options)

    monkeypatch.setattr(Text, "draw", noting)
    figure.canvas.draw()
    assert len(boxes) > 20
    for (one, box), (other, behind) in itertools.combinations(boxes, 2):
        apart = box.x1 <= behind.x0 or behind.x1 <= box.x0 or box.y1 <= behind.y0 or behind.y1 <= box.y0
        assert apart, f"'{one}' and '{other}' overlap: {box}, {behind}"
    for text, box in boxes:
        assert min(box.x0, box.y0) >= 0, text
        assert (box.max <= figure.bbox.max).all(), text


def test_every_motion_gaze_and_goal_is_drawn_in_its_colour(tmp_path):
    path = tmp_path / "view.png"
    draw_sheet([a_scene("mdm, text", "pr, goal-loc")], path)
    pixels = (matplotlib.image.imread(path)[..., :3] * 255).round().astype(int)
    for colour in (RECORDED_COLOUR, *METHOD_COLOURS[:2], GAZE_COLOUR, GOAL_COLOUR):
        near = np.abs(pixels - rgb(colour)).max(axis=-1) < 12
        assert near.sum() > 50, colour
    absent = np.abs(pixels - rgb(METHOD_COLOURS[2])).max(axis=-1) < 12
    assert not absent.any()


def test_generated_gaze_is_drawn_as_the_recorded_one_is():
    def gaze_lines(figure: Figure) -> int:
        return sum(line.get_color() == GAZE_COLOUR for line in figure.findobj(Line2D))

    without, with_eyes = (_drawn(a_scene("pr, goal-loc", with_eyes=eyes)) for eyes in (False, True))
    assert gaze_lines(with_eyes) == gaze_lines(without) + len(chosen_frames(a_scene()))
    words = [" ".join(text.get_text() for text in figure.findobj(Text)) for figure in (without, with_eyes)]
    assert ["generated gaze" in each for each in words] == [False, True]


def test_colours_stay_apart_for_eyes_without_red_or_green_receptors():
    """Machado's matrices of full protanopia and deuteranopia, in linear light."""
    matrices = (
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    )
    colours = [RECORDED_COLOUR, GAZE_COLOUR, GOAL_COLOUR, *METHOD_COLOURS]
    linear = (np.array([rgb(colour) for colour in colours]) / 255.0) ** 2.2
    for matrix in matrices:
        seen = np.clip(linear @ np.transpose(matrix), 0, 1) ** (1 / 2.2) * 255
        distance = np.linalg.norm(seen[:, None] - seen[None], axis=-1) + 1e3 * np.eye(len(colours))
        assert distance.min() > 25, np.unravel_index(distance.argmin(), distance.shape)


def test_the_same_scenes_give_the_same_bytes(tmp_path):
    for name in ("one.png", "two.png"):
        draw_sheet([a_scene("static, none")], tmp_path / name, dpi=40)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_first_prime_and_last_frame_are_among_the_poses():
    for n_frames in (42, 61, 200):
        scene = a_scene(n_frames=n_frames)
        frames = chosen_frames(scene)
        assert {0, scene.prime_frame, n_frames - 1} <= set(frames.tolist())
        assert (np.diff(frames) > 0).all()
    assert chosen_frames(a_scene(n_frames=2)).tolist() == [0, 1]


def test_without_goal_and_gaze_the_generated_motion_is_still_drawn(tmp_path):
    draw_sheet([a_scene("pr, goal-pose", recorded=False, notice="must not be passed on")], tmp_path / "view.png")
    figure = _drawn(a_scene("pr, goal-pose", recorded=False))
    words = " ".join(text.get_text() for text in figure.findobj(Text))
    assert "ground truth" not in words
    assert "gaze" not in words
    assert "goal" not in words.split()


def test_progress_is_told_and_an_unwritable_place_named(tmp_path):
    told = []
    draw_sheet([a_scene(), a_scene()], tmp_path / "a.png", dpi=40, progress=lambda *step: told.append(step[:2]))
    assert told == [(1, 2), (2, 2)]
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match=r"file"):
        draw_sheet([a_scene()], tmp_path / "file" / "a.png")


def test_a_picture_is_as_wide_as_a_text_column_with_text_that_can_be_read_there():
    figure = _drawn(a_scene("mdm, text", "pr, goal-loc"))
    assert figure.get_figwidth() == COLUMN == 3.5
    sizes = {text.get_fontsize() for text in figure.findobj(Text) if text.get_text().strip()}
    assert min(sizes) >= 6


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_the_caption_stands_in_the_file_and_says_what_is_shown(suffix, tmp_path):
    path = tmp_path / f"view{suffix}"
    caption = draw_sheet([a_scene("pr, goal-loc")], path)
    assert "pr, goal-loc" in caption
    assert "within 25 cm" in caption
    words = b"Bodies from the side at the same moments"
    assert words in path.read_bytes()


def test_right_and_left_limbs_differ_and_the_nearer_one_lies_on_top():
    scene = a_scene()
    joints = scene.motions[0].joints[:1]
    lines = _drawn(scene).axes[0].collections[0]
    shades = {tuple(np.round(colour, 3)) for colour in lines.get_colors()}
    assert len(shades) == 3, "white outlines, right limbs with the trunk, left limbs"
    towards = np.cross(scene.picture_axis, [0.0, 1.0, 0.0])
    ankles = joints[0, [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]] @ towards
    axes = Figure(figsize=(2, 2)).add_subplot(xlim=(-1, 1), ylim=(0, 2))
    drawn = body_lines(axes, joints, "#000000", lambda points: points[..., :2], towards, head_tilt_deg=0.0)
    last = drawn["color"][-1]
    assert ankles[0] != ankles[1]
    assert last.max() < 1, "a fill, not an outline, is drawn last"
