"""Feet that glide are made to step: they stand or swing, and stay close to where they are wanted."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from prbench_adapters.diffusion.footsteps import LAG, LIFT, SURE_LAG, stepped

FPS = 20.0
LOW = 0.05
SLIDE = 0.2


def gliding(speed: float = 0.8, frames: int = 80, height: float = 0.02) -> np.ndarray:
    """Toes (frames, 2, 3) that stand for a second, glide ahead side by side, and stand for a second."""
    way = np.clip(np.arange(frames) - 20, 0, frames - 40) * speed / FPS
    toes = np.zeros((frames, 2, 3))
    toes[:, 0, 0], toes[:, 1, 0] = 0.1, -0.1
    toes[..., 2] = way[:, None]
    toes[..., 1] = height
    return toes


def walked(toes: np.ndarray, *, sure: bool = False, fps: float = FPS, keeps_last: bool = False) -> np.ndarray:
    return stepped(toes, np.full(toes.shape[:2], sure), fps, keeps_last=keeps_last)


def slides(toes: np.ndarray) -> np.ndarray:
    low = toes[..., 1] < LOW
    quick = np.linalg.norm(np.diff(toes[..., ::2], axis=0), axis=-1) * FPS > SLIDE
    return quick & low[1:] & low[:-1]


@pytest.mark.parametrize("speed", [0.3, 0.8, 1.4])
def test_gliding_feet_step_and_do_not_slide(speed):
    toes = gliding(speed)
    found = walked(toes)
    assert slides(toes).any(axis=1).mean() > 0.4
    assert slides(found).any(axis=1).mean() < 0.1
    still = np.linalg.norm(np.diff(found[..., ::2], axis=0), axis=-1) < 1e-9
    assert still.any(axis=1).all(), "one foot is always on the floor"
    assert found[..., 1].max() == pytest.approx(0.02 + LIFT, abs=0.01)


def test_feet_stay_near_to_where_they_are_wanted_and_left_and_right_alternate():
    toes = gliding()
    found = walked(toes)
    away = np.linalg.norm((found - toes)[..., ::2], axis=-1)
    assert away.max() < 0.4  # half of what a body does at 0.8 m/s while both feet take a step
    assert away[-1].max() < LAG
    high = found[..., 1] > LOW
    started = [(frame, foot) for foot in (0, 1) for frame in np.flatnonzero(np.diff(high[:, foot].astype(int)) > 0)]
    feet = [foot for _, foot in sorted(started)]
    assert len(feet) >= 4
    assert all(first != second for first, second in pairwise(feet))


def test_feet_that_are_wanted_in_one_place_stay_in_it():
    toes = gliding(speed=0.0, height=0.03) + np.random.default_rng(0).normal(0, 0.005, (80, 2, 3))
    found = walked(toes)
    np.testing.assert_array_equal(found[:, :, ::2], np.broadcast_to(found[:1, :, ::2], (80, 2, 2)))


def test_a_foot_of_which_the_network_is_sure_waits_longer():
    toes = gliding(speed=0.1)
    toes[..., 2] = np.minimum(toes[..., 2], (LAG + SURE_LAG) / 2)
    moved = walked(toes)
    kept = walked(toes, sure=True)
    assert np.ptp(moved[..., 2]) > LAG
    assert np.ptp(kept[..., 2]) == 0


@pytest.mark.parametrize("keeps_last", [False, True])
@pytest.mark.parametrize("frames", [2, 3, 9, 80])
def test_given_frames_are_kept(frames, keeps_last):
    toes = gliding(frames=max(frames, 41))[-frames:]
    toes[:, 1, 1] += 0.04
    toes[-1, 0] += 0.03
    found = walked(toes, keeps_last=keeps_last)
    np.testing.assert_allclose(found[0], toes[0], atol=1e-12)
    if keeps_last:
        np.testing.assert_allclose(found[-1], toes[-1], atol=1e-12)


def test_a_foot_in_the_air_goes_on_with_its_speed():
    toes = gliding(frames=60, speed=0.0)
    left = 1 - np.minimum(np.arange(60) / 8, 1)
    toes[:, 0, 2] = 0.3 * (1 - left**3)
    toes[:, 0, 1] = 0.02 + 0.08 * left
    found = walked(toes)
    np.testing.assert_allclose(found[1, 0, ::2] - found[0, 0, ::2], toes[1, 0, ::2] - toes[0, 0, ::2], atol=5e-3)
    assert not slides(found).any()
    np.testing.assert_allclose(found[-1, 0, ::2], toes[-1, 0, ::2], atol=5e-3)


def test_feet_on_a_step_stay_at_its_height_and_those_wanted_below_the_floor_stand_on_it():
    assert walked(gliding(height=0.3))[..., 1].min() == pytest.approx(0.3)
    toes = gliding(height=-0.04)
    toes[0, :, 1] = 0.0
    assert walked(toes)[..., 1].min() == 0


def test_a_longer_motion_at_another_rate_steps_as_often():
    coarse = gliding()
    fine = np.repeat(coarse, 2, axis=0)
    found = [walked(coarse), walked(fine, fps=2 * FPS)]
    counts = [int((np.diff((toes[..., 1] > LOW).astype(int), axis=0) > 0).sum()) for toes in found]
    assert abs(counts[0] - counts[1]) <= 1


def test_feet_that_end_close_to_where_they_stand_turn_on_the_floor():
    toes = gliding(speed=0.0)
    toes[-1, :, 0] += (0.04, -0.02)
    found = walked(toes, keeps_last=True)
    assert found[..., 1].max() < LOW
    assert not slides(found).any()
    assert found[-1] == pytest.approx(toes[-1])


def test_of_two_feet_that_stand_and_end_elsewhere_one_is_always_on_the_floor():
    toes = gliding(speed=0.0)
    toes[-1, :, 2] += 0.3
    found = walked(toes, keeps_last=True)
    assert found[..., 1].max(axis=0) == pytest.approx([0.02 + LIFT] * 2, abs=0.01)
    assert (found[..., 1].min(axis=1) < LOW).all()
    assert found[-1] == pytest.approx(toes[-1])
