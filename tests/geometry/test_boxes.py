"""Boxes around sequences: depth, frames, and which of them a motion can reach."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.shapes import Boxes, deepest


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
