"""Scene penetration by hand: how often and how deep a body stands in a box."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.geometry.shapes import Boxes
from prbench.geometry.skeleton import Joint
from prbench.metrics import score
from prbench.metrics.scene_penetration import scene_penetration
from tests.metrics.motions import CONSTANTS, batch, standing, targets


def with_boxes(*boxes, offsets=None):
    """Targets of sequences with upright boxes: (centre, half extents) each."""
    scene = Boxes(
        np.array([centre for centre, _ in boxes], dtype=float).reshape(-1, 3),
        np.repeat(np.eye(3)[None], len(boxes), axis=0),
        np.array([half for _, half in boxes], dtype=float).reshape(-1, 3),
        np.array([0, len(boxes)] if offsets is None else offsets),
    )
    return dataclasses.replace(targets(len(scene)), scene=scene)


COUNTER = ((0.0, 0.45, 1.0), (1.0, 0.45, 0.3))
"""A counter from 0.7 to 1.3 m before the body, 0.9 m high."""


def walking_in(depth: float, frames: int = 10) -> np.ndarray:
    """A body that stands still but in its last three frames, in which a knee is ``depth`` inside the counter."""
    motion = standing(frames)
    motion[-3:, Joint.LEFT_KNEE] = (0.1, 0.45, 0.7 + depth)
    return motion


@pytest.mark.parametrize(("deep", "frames"), [(0.12, 0.3), (0.04, 0.0)])
def test_three_of_ten_frames_are_inside_and_a_little_is_allowed_and_still_measured(deep, frames):
    share, largest = scene_penetration(batch(walking_in(deep)), with_boxes(COUNTER), depth=0.05)
    assert share == pytest.approx([frames])
    assert largest == pytest.approx([deep])


def test_a_box_that_holds_the_goal_is_open():
    reached_into = dataclasses.replace(with_boxes(COUNTER), goal_location=np.array([[0.0, 0.5, 1.0]]))
    assert scene_penetration(batch(walking_in(0.12)), reached_into, depth=0.05)[1].tolist() == [0.0]


def test_every_sequence_has_its_own_boxes():
    motions = batch(walking_in(0.12), walking_in(0.12), walking_in(0.12))
    share, _ = scene_penetration(motions, with_boxes(COUNTER, COUNTER, offsets=[0, 1, 1, 2]), depth=0.05)
    assert share == pytest.approx([0.3, 0.0, 0.3])


def test_scores_hold_it_only_where_boxes_are_known():
    motion = batch(walking_in(0.12))
    assert "scene_penetration" not in score(motion, motion, targets(), CONSTANTS)
    found = score(motion, motion, with_boxes(COUNTER), CONSTANTS)
    assert found["scene_penetration"].value == pytest.approx([0.3])
    assert found["scene_depth"].value == pytest.approx([0.12])
    nothing = score(motion, motion, with_boxes(), CONSTANTS)
    assert nothing["scene_depth"].flag == ["no_boxes"]
    with pytest.raises(ValueError, match="hold no boxes"):
        score(motion, motion, targets(), CONSTANTS, metrics=["scene_depth"])
