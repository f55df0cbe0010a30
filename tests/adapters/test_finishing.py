"""Finished motions have rigid bones and feet that stand or swing; what is given stays, whatever the batch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.contract import Condition, Motions
from prbench.geometry.skeleton import TOES, bone_lengths
from prbench_adapters.finishing import Finishing, finish
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import STANDING

FPS = 20.0
LENGTHS = bone_lengths(STANDING.astype(np.float64))[None]


def gliding(speed: float = 0.8, frames: int = 80) -> np.ndarray:
    """A standing body (1, frames, 22, 3) that glides ahead after a second, and stands for the last one; bones waver."""
    way = np.clip(np.arange(frames) - 20, 0, frames - 40) * speed / FPS
    joints = STANDING * (1 + 0.02 * np.sin(np.arange(frames) / 7))[:, None, None]
    joints[..., 2] += way[:, None]
    return joints[None].astype(np.float32)


def finished(joints: np.ndarray, **named) -> np.ndarray:
    given = {"lengths": np.repeat(LENGTHS, len(joints), axis=0), "feet": True, "keep_last": False, **named}
    return finish(joints, np.full(len(joints), joints.shape[1]), FPS, **given)


@pytest.mark.parametrize("frames", [4, 30])
def test_a_motion_begins_in_the_given_pose_and_ends_where_it_did(frames):
    batch = conditions(Condition.GOAL_LOCATION, 1, frames=(frames,))
    assert batch.initial_joints is not None
    beside = batch.initial_joints + 0.2 * np.float32([1, 0, 1])
    motions = Motions(np.repeat(beside[:, None], frames, axis=1), batch.n_frames)
    found = Finishing(feet=False)(motions, batch).joints
    np.testing.assert_allclose(found[0, 0], batch.initial_joints[0], atol=1e-5)
    np.testing.assert_allclose(found[0, -1], beside[0], atol=1e-5)
    assert found.dtype == np.float32


def test_bones_have_the_lengths_that_are_given_and_feet_do_not_glide():
    found = finished(gliding())
    np.testing.assert_allclose(bone_lengths(found[0]), np.tile(LENGTHS, (80, 1)), atol=1e-5)
    toes = found[0, :, TOES]
    quick = np.linalg.norm(np.diff(toes[..., ::2], axis=1), axis=-1) * FPS > 0.2
    assert not (quick & (toes[:, 1:, 1] < 0.03)).any(axis=0).mean() > 0.17
    np.testing.assert_allclose(found[0, 0], gliding()[0, 0], atol=1e-5)


def test_padding_and_the_rest_of_a_batch_change_no_byte():
    joints = np.concatenate([gliding(0.5), gliding(1.0)])
    joints[0, 60:] = np.nan
    found = finish(joints, np.array([60, 80]), FPS, lengths=np.tile(LENGTHS, (2, 1)), feet=True, keep_last=False)
    alone = finish(joints[:1, :60], np.array([60]), FPS, lengths=LENGTHS, feet=True, keep_last=False)
    assert found[0, :60].tobytes() == alone[0].tobytes()
    assert np.isnan(found[0, 60:]).all()


def test_the_options_leave_what_they_name_as_the_network_has_it():
    batch = conditions(Condition.GOAL_LOCATION, 1)
    motions = Motions(gliding(frames=int(batch.n_frames[0]) + 41), batch.n_frames)
    assert Finishing.of({"bones": "predicted", "feet": "predicted"})(motions, batch) is motions
    assert Finishing.of({}) == Finishing(bones=True, feet=True)
    with pytest.raises(ValueError, match="option 'feet': expected steps or predicted, found 'gliding'"):
        Finishing.of({"feet": "gliding"})


@pytest.mark.parametrize("miss", [0.0, 0.2])
def test_a_goal_pose_that_the_motion_ends_in_stays(miss):
    batch = conditions(Condition.GOAL_POSE, 1)
    joints = gliding(frames=80)
    batch = dataclasses.replace(
        batch, n_frames=np.array([80]), initial_joints=joints[:, 0], goal_joints=joints[:, -1] + np.float32(miss)
    )
    found = Finishing(bones=False)(Motions(joints, batch.n_frames), batch).joints
    assert np.allclose(found[0, -1], joints[0, -1], atol=1e-5) == (miss == 0.0)
