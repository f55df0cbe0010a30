"""Motions are led around boxes, smoothly, and stay as they are where no box is in the way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.errors import AdapterError
from prbench.geometry.boxes import Boxes, deepest
from prbench.geometry.skeleton import BONES, Joint
from prbench_adapters.diffusion.obstacles import led_around
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import STANDING

FRAMES = 40


def walk() -> Motions:
    """A body that glides 1.2 m ahead within two seconds."""
    way = np.linspace(0.0, 1.2, FRAMES, dtype=np.float32)[:, None] * np.array([0.0, 0.0, 1.0], dtype=np.float32)
    return Motions((STANDING.astype(np.float32) + way[:, None])[None], np.array([FRAMES]))


def asked(condition: Condition = Condition.GOAL_LOCATION, **box) -> ConditionBatch:
    """One row with a post of 20 cm beside the way, which the left side of the body comes into."""
    post = {"centre": (0.2, 0.5, 0.7), "half": (0.1, 0.5, 0.1), **box}
    boxes = Boxes(
        np.array([post["centre"]], dtype=float),
        np.eye(3)[None],
        np.array([post["half"]], dtype=float),
        np.array([0, 1]),
    )
    batch = conditions(condition, 1, frames=(FRAMES,))
    goal = {"goal_location": np.array([[0.0, 1.2, 1.6]])} if condition is Condition.GOAL_LOCATION else {}
    return dataclasses.replace(batch, obstacles=boxes, **goal)


def depths(motions: Motions, batch: ConditionBatch) -> np.ndarray:
    assert batch.obstacles is not None
    return deepest(motions.joints[0].astype(np.float64), batch.obstacles)


def test_a_body_is_led_past_a_post():
    batch = asked()
    before, after = walk(), led_around(walk(), batch)
    assert depths(before, batch).max() > 0.08
    assert depths(after, batch).max() < 0.01
    change = after.joints[0] - before.joints[0]
    assert np.abs(change[0]).max() < 1e-5, "the first pose is given"
    steps = np.linalg.norm(np.diff(change, axis=0), axis=-1)
    assert steps.max() < 0.04, "the way bends, it does not jump"


def test_bones_keep_their_lengths():
    parents, children = np.transpose(BONES)
    lengths = [
        np.linalg.norm(motions.joints[0][:, children] - motions.joints[0][:, parents], axis=-1)
        for motions in (walk(), led_around(walk(), asked()))
    ]
    assert lengths[1] == pytest.approx(lengths[0], abs=1e-5)


def test_a_motion_that_comes_into_no_box_stays_to_the_bit():
    apart = led_around(walk(), asked(centre=(3.0, 0.5, 0.7)))
    assert np.array_equal(apart.joints, walk().joints)


def test_the_box_that_holds_the_goal_is_open():
    around_the_goal = asked(centre=(0.0, 0.9, 1.2), half=(0.5, 0.9, 0.6))
    assert np.array_equal(led_around(walk(), around_the_goal).joints, walk().joints)


def test_a_given_last_pose_is_kept():
    last = led_around(walk(), asked(Condition.GOAL_POSE, centre=(0.2, 0.5, 1.1))).joints[0, -1]
    assert last == pytest.approx(walk().joints[0, -1], abs=1e-5)
    assert np.abs(last[Joint.HEAD] - walk().joints[0, -1, Joint.HEAD]).max() < 1e-5


def test_without_boxes_the_option_is_refused():
    with pytest.raises(AdapterError, match="expected the boxes of the scene"):
        led_around(walk(), dataclasses.replace(asked(), obstacles=None))
