"""The method ``wandr`` through the contract."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint, bone_lengths
from prbench.harness.methods.loading import load_adapter
from prbench.representation import mirror
from prbench_adapters.wandr.adapter import WANDR
from prbench_adapters.wandr.network import TRANSLATION
from tests.adapters.wandr import tiny

RIGHT, LEFT = Joint.RIGHT_WRIST, Joint.LEFT_WRIST


def _method(**settings) -> WANDR:
    return WANDR(tiny.network().double(), Path("tiny"), **settings)


class Follower(torch.nn.Module):
    """In place of a trained decoder: the whole body moves as the wrist intends."""

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        delta = torch.zeros(len(values), 135).to(values)
        delta[:, TRANSLATION] = values[:, -9:-6] / 30 / (0.02 + 1e-5)  # metres a frame, standardised
        return delta


def _follower(**settings) -> WANDR:
    method = _method(**settings)
    method.network.decoder = torch.nn.Sequential(Follower())
    return method


def test_motions_begin_with_the_given_pose_and_keep_its_bones():
    batch = tiny.batch()
    motions = _method().generate(batch, seed=0)
    assert motions.joints.shape == (3, 30, 22, 3)
    assert np.array_equal(motions.joints[:, 0], batch.initial_joints)
    expected = bone_lengths(batch.initial_joints)[:, None]
    assert np.allclose(bone_lengths(motions.joints), expected, atol=1e-5)
    assert np.isfinite(motions.joints).all()
    assert motions.cost.network_passes == sum(batch.n_frames - 1)  # one for each frame after the given one


def test_a_body_that_follows_its_intention_has_its_right_wrist_at_the_goal_in_the_last_frame():
    batch = tiny.batch()
    motions = _follower().generate(batch, seed=0)
    for row, n in enumerate(batch.n_frames):
        distance = np.linalg.norm(motions.joints[row, :n, RIGHT] - batch.goal_location[row], axis=-1)
        assert distance[-1] < 1e-4
        assert (np.diff(distance) < 0).all()


def test_a_late_body_is_asked_for_no_more_than_the_most_speed_of_option_and_network():
    batch, method = tiny.batch(frames=(20,)), _follower()

    def steps() -> np.ndarray:
        return np.linalg.norm(np.diff(method.generate(batch, seed=0).joints[0, :, RIGHT], axis=0), axis=-1)

    free = steps()
    half = float(free[0]) * 30 / 2
    method.most_speed = half
    assert steps() == pytest.approx(half / 30, rel=1e-4)
    method.most_speed = None
    method.network.configuration = msgspec.structs.replace(method.network.configuration, most_speed=0.1)
    assert steps() == pytest.approx(0.1 / 30, rel=1e-4)
    method.network.configuration = msgspec.structs.replace(method.network.configuration, most_speed=1.5)
    by_itself = steps()
    method.most_speed = 1.0
    assert np.array_equal(steps(), by_itself), "one metre a second at most, unless more is asked for"
    method.most_speed = math.inf
    assert np.array_equal(steps(), free)


def test_a_foot_stays_on_the_floor_unless_the_network_is_to_decide():
    """The follower rises with its wrist to a goal above the head."""
    batch = tiny.batch(1, frames=(24,))
    batch = replace(batch, goal_location=batch.initial_joints[:, Joint.HEAD] + np.float32([0.0, 0.5, 0.3]))
    lowest = {
        feet: _follower(feet=feet).generate(batch, seed=0).joints[0, :, :, 1].min(axis=-1) for feet in (False, True)
    }
    assert lowest[0][-1] > 0.5
    assert lowest[1].max() < 0.06
    assert np.array_equal(_follower(feet=True).generate(batch, seed=0).joints[:, 0], batch.initial_joints)


def test_the_nearest_hand_is_chosen_for_each_row():
    batch = tiny.batch(2, frames=(20,))
    wrists = batch.initial_joints[0, [LEFT, RIGHT]]
    batch = replace(batch, goal_location=wrists + np.float32([0, 0, 0.3]))
    motions = _follower(hand="nearest").generate(batch, seed=0)
    assert np.allclose(motions.joints[0, -1, LEFT], batch.goal_location[0], atol=1e-4)
    assert np.allclose(motions.joints[1, -1, RIGHT], batch.goal_location[1], atol=1e-4)


def test_left_hands_are_right_hands_in_a_mirror():
    batch = tiny.batch()
    seen = replace(
        batch,
        initial_joints=mirror(batch.initial_joints),
        previous_joints=mirror(batch.previous_joints),
        goal_location=batch.goal_location * np.float32([-1, 1, 1]),
    )
    left = _method(hand="left").generate(batch, seed=0)
    right = _method().generate(seen, seed=0)
    assert np.allclose(left.joints, mirror(right.joints), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("initial_joints", (1, 5), np.nan, "initial_joints, frame 1, right_knee"),
        ("previous_joints", (0, 21), tiny.batch().previous_joints[0, 19], "right_wrist"),
    ],
)
def test_what_cannot_be_is_refused(name, place, value, message):
    values = getattr(tiny.batch(), name).copy()
    values[place] = value
    with pytest.raises(InputFileError, match=message):
        _method().generate(replace(tiny.batch(), **{name: values}), seed=0)


def test_weights_are_found_and_declared(tmp_path):
    path = tiny.write(tmp_path / "mine.safetensors")
    for given in (path, tmp_path):
        method = load_adapter("wandr", given, {"hand": "nearest"}, "cpu")
        assert method.weights_for(Condition.GOAL_LOCATION) == path
        assert method.native_fps == 30
        assert (method.hand, method.most_speed, method.feet) == ("nearest", None, True)
    assert not load_adapter("wandr", path, {"feet": "predicted"}, "cpu").feet
    assert load_adapter("wandr", path, {"most-speed": "0"}, "cpu").most_speed == math.inf
    assert load_adapter("wandr", path, {"most-speed": "1.5"}, "cpu").most_speed == 1.5
    assert load_adapter("wandr", path, {}, "cpu").generate(tiny.batch(), seed=0).joints.shape == (3, 30, 22, 3)
