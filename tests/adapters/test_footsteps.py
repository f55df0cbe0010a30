"""Feet that glide are made to step: they stand or swing, as the network does where it does, near to its places."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from prbench.geometry.skeleton import TOES
from prbench_adapters.footsteps import ANKLES, LAG, stepped
from tests.fakes import STANDING

FPS = 20.0
LOW = 0.03
SLIDE = 0.2
LEGS = [*ANKLES, *TOES]


def gliding(speed: float = 0.8, frames: int = 80, height: float = 0.02) -> np.ndarray:
    """A body (frames, 22, 3) that stands for a second, glides ahead, and stands for a second."""
    body = np.repeat(STANDING[None].astype(np.float64), frames, axis=0)
    body[..., 2] += (np.clip(np.arange(frames) - 20, 0, max(frames - 40, 0)) * speed / FPS)[:, None]
    body[:, TOES, 1] = height
    return body


def swinging(length: float, frames: range, foot: int = 0, *, lift: float = 0.04) -> np.ndarray:
    """A standing body, one foot of which swings ahead while the frames last, and whose pelvis follows."""
    body = gliding(speed=0.0)
    share = np.clip((np.arange(80) - frames.start) / (frames.stop - frames.start), 0, 1)
    limb = [ANKLES[foot], TOES[foot]]
    body[:, limb, 2] += (length * share)[:, None]
    body[:, limb, 1] += (lift * np.sin(np.pi * share))[:, None]
    body[:, 0, 2] += length / 2 * share
    return body


def walked(body: np.ndarray, *, fps: float = FPS, keep_last: bool = False) -> np.ndarray:
    return stepped(body, fps, keep_last=keep_last)[0]


def slides(feet: np.ndarray) -> np.ndarray:
    low = feet[..., 1] < LOW
    quick = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * FPS > SLIDE
    return quick & low[1:] & low[:-1]


def lifts(feet: np.ndarray) -> list[tuple[int, int]]:
    high = feet[..., 1] > LOW
    return sorted((frame, foot) for foot in (0, 1) for frame in np.flatnonzero(np.diff(high[:, foot].astype(int)) > 0))


@pytest.mark.parametrize("speed", [0.3, 0.8, 1.4])
def test_gliding_feet_step_and_do_not_slide(speed):
    body = gliding(speed)
    found = walked(body)
    assert slides(body[:, TOES]).any(axis=1).mean() > 0.4
    assert slides(found).any(axis=1).mean() < 0.1
    still = np.linalg.norm(np.diff(found[..., [0, 2]], axis=0), axis=-1) < 1e-9
    assert still.any(axis=1).all(), "one foot is always on the floor"


def test_feet_stay_near_to_where_they_are_wanted_and_left_and_right_alternate():
    body = gliding()
    found = walked(body)
    away = np.linalg.norm((found[..., :3] - body[:, TOES])[..., [0, 2]], axis=-1)
    assert away.max() < 0.5  # what a body does at 0.8 m/s while both feet take a step, less a quarter
    assert away[-1].max() < LAG
    feet = [foot for _, foot in lifts(found)]
    assert len(feet) >= 3
    assert all(first != second for first, second in pairwise(feet))


@pytest.mark.parametrize("frames", [range(30, 38), range(40, 50)])
def test_a_foot_swings_when_the_network_swings_it_and_longer_steps_rise_higher(frames):
    rises = []
    for length in (0.2, 0.6):
        found = walked(swinging(length, frames))
        ((start, foot),) = lifts(found)
        assert foot == 0
        assert frames.start <= start + 1 <= frames.start + 2
        landed = start + 1 + int(np.argmax(found[start + 1 :, 0, 1] < LOW))
        assert abs(landed - frames.stop) <= 1
        rises.append(found[:, 0, 1].max())
    assert 0.05 < rises[0] < rises[1]
    high = walked(swinging(0.6, frames, lift=0.14))
    assert high[:, 0, 1].max() > rises[1] + 0.03, "a foot that is lifted higher rises higher"


def test_a_swing_lasts_from_its_slow_begin_to_its_slow_end():
    """The foot moves for ten frames, as hands and feet do: in the first and last two by less than 0.2 m/s."""
    share = np.clip((np.arange(80) - 30) / 10, 0, 1)
    body = gliding(speed=0.0)
    body[:, [ANKLES[0], TOES[0]], 2] += (0.3 * share**3 * (10 - 15 * share + 6 * share**2))[:, None]
    moved = np.flatnonzero(np.abs(np.diff(walked(body)[:, 0, 2])) > 1e-6)
    assert len(moved) >= 9


def test_a_foot_lies_where_it_landed_however_it_is_turned_until_that_is_too_much():
    body = gliding(speed=0.0)
    turns = np.deg2rad(np.linspace(0, 30, 80))
    foot = STANDING[TOES[0]] - STANDING[ANKLES[0]]
    for turn, share in ((turns, 0.0), (4 * turns, 1.0)):
        body[:, TOES[0], 0] = body[:, ANKLES[0], 0] + foot[2] * np.sin(turn)
        body[:, TOES[0], 2] = body[:, ANKLES[0], 2] + foot[2] * np.cos(turn)
        yaw = walked(body)[:, 0, 3]
        assert np.ptp(yaw) == pytest.approx(share * np.deg2rad(120), abs=np.deg2rad(25) * share)


@pytest.mark.parametrize("keep_last", [False, True])
@pytest.mark.parametrize("frames", [2, 3, 9, 80])
def test_given_frames_are_kept(frames, keep_last):
    body = gliding(frames=max(frames, 41))[-frames:]
    body[:, TOES[1], 1] += 0.04
    body[-1, TOES[0]] += 0.03
    found = walked(body, keep_last=keep_last)[..., :3]
    np.testing.assert_allclose(found[0], body[0, TOES], atol=1e-12)
    if keep_last:
        np.testing.assert_allclose(found[-1], body[-1, TOES], atol=1e-12)


def test_a_foot_in_the_air_lands_before_the_other_one_leaves_the_floor():
    body = swinging(0.4, range(-4, 4))
    body[:, [ANKLES[1], TOES[1]], 2] += np.clip(np.arange(80) / 8, 0, 1)[:, None] * 0.4
    found = walked(body)
    np.testing.assert_allclose(found[0, 0, :3], body[0, TOES[0]], atol=1e-9)
    assert (found[..., 1].min(axis=1) < LOW).all()


def test_no_more_than_three_feet_are_lifted_within_a_second():
    body = gliding(speed=0.0)
    body[:, [ANKLES[0], TOES[0]], 2] += 0.15 * np.sign(np.sin(np.arange(80) * 2 * np.pi / 8))[:, None]
    frames = np.array([frame for frame, _ in lifts(walked(body))])
    assert len(frames) >= 3
    assert all((np.abs(frames - frame) <= FPS).sum() <= 5 for frame in frames)
    assert all(((frames >= frame) & (frames <= frame + FPS)).sum() <= 3 for frame in frames)


def test_of_two_feet_that_stand_and_end_elsewhere_one_is_always_on_the_floor():
    body = gliding(speed=0.0)
    body[-24:, LEGS, 2] += np.linspace(0, 0.3, 24)[:, None]
    found = walked(body, keep_last=True)
    assert (found[..., 1].max(axis=0) > 0.05).all()
    assert (found[..., 1].min(axis=1) < LOW).all()
    np.testing.assert_allclose(found[-1, :, :3], body[-1, TOES])


def test_feet_that_float_are_brought_to_the_floor():
    body = gliding()
    body[1:, :, 1] += 0.06
    assert (walked(body)[10:, :, 1].min(axis=1) < LOW).all()


def test_a_longer_motion_at_another_rate_steps_as_often():
    coarse = gliding()
    fine = np.repeat(coarse, 2, axis=0)
    counts = [len(lifts(walked(coarse))), len(lifts(walked(fine, fps=2 * FPS)))]
    assert abs(counts[0] - counts[1]) <= 1
