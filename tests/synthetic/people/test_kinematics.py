"""Blends, wobbles, limbs and filters of which motion is made, against hand-worked values and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from prbench.geometry.skeleton import rotation_matrices
from prbench.randomness import named_generator
from prbench.synthetic.people.kinematics import (
    blend,
    eased_trapezoid,
    minimum_jerk,
    quaternion,
    rotation,
    rotation_quaternion,
    turn,
    two_bone,
    two_pole_low_pass,
    wobble,
)


def rng(*name: str | int) -> np.random.Generator:
    return named_generator("test", *name)


def test_minimum_jerk_passes_through_the_middle_and_stays_at_its_ends() -> None:
    assert minimum_jerk(np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0])) == pytest.approx([0, 0, 0.103515625, 0.5, 1, 1])


def test_a_blend_ends_exactly_on_a_moving_target() -> None:
    times = np.arange(0.0, 3.0, 0.01)
    channel, target = np.zeros(times.size), np.sin(times)
    blend(channel, times, 0.5, 1.0, target)
    assert np.all(channel[times < 0.5] == 0.0)
    assert np.all(channel[times >= 1.5] == target[times >= 1.5])


def test_an_eased_trapezoid_covers_the_way_without_a_jump_of_speed() -> None:
    progress = eased_trapezoid(np.linspace(0.0, 1.0, 1001), 0.3, 0.4)
    assert progress[[0, -1]] == pytest.approx([0.0, 1.0])
    speed = np.diff(progress) * 1000
    assert speed.max() == pytest.approx(1.0 / (1.0 - 0.15 - 0.2), rel=1e-6)
    assert np.abs(np.diff(speed)).max() < 0.02


def test_a_wobble_has_the_wanted_size() -> None:
    assert np.std(wobble(np.arange(0.0, 400.0, 0.02), 0.3, 0.3, 3.0, rng("wobble"))) == pytest.approx(0.3, rel=0.1)


def test_two_bone_limbs_keep_their_lengths_and_reach_what_is_within_reach() -> None:
    root, target = rng("limb").normal(size=(2, 200, 3))
    pole = np.tile([0.0, -1.0, 0.3], (200, 1))
    middle, end = two_bone(root, target, (0.9, 1.1), pole, (0.95, 0.995))
    assert np.linalg.norm(middle - root, axis=1) == pytest.approx(0.9)
    assert np.linalg.norm(end - middle, axis=1) == pytest.approx(1.1)
    near = np.linalg.norm(target - root, axis=1) < 0.95 * 2.0
    near &= np.linalg.norm(target - root, axis=1) > 0.25
    assert end[near] == pytest.approx(target[near])


def test_quaternions_and_matrices_agree() -> None:
    yaw, pitch = rng("angles").uniform(-7.0, 7.0, (2, 300))
    matrices = rotation(yaw, pitch)
    assert rotation_matrices(quaternion(matrices)) == pytest.approx(matrices)
    assert rotation_quaternion(yaw, pitch) == pytest.approx(quaternion(matrices))
    assert matrices @ [0.0, 0.0, 1.0] == pytest.approx(turn(yaw, pitch, np.array([0.0, 0.0, 1.0])))


"""The filter of which turned trunks are made, against SciPy's."""


def _by_scipy(values: np.ndarray, time_constant: float, rate: float) -> np.ndarray:
    decay = np.exp(-1.0 / (time_constant * rate))
    for _ in range(2):
        values = lfilter([1.0 - decay], [1.0, -decay], values, zi=[decay * values[0]])[0]
    return values


@pytest.mark.parametrize("n", [1, 2, 7, 4000])
@pytest.mark.parametrize("rate", [20.0, 60.0, 1000.0])
def test_the_low_pass_is_scipys_and_rests_on_the_first_value(n, rate):
    values = np.random.default_rng(n).normal(size=n)
    filtered = two_pole_low_pass(values, 0.3, rate)
    np.testing.assert_allclose(filtered, _by_scipy(values, 0.3, rate), rtol=1e-12, atol=0)
    assert filtered[0] == pytest.approx(values[0], rel=1e-12)
    assert two_pole_low_pass(np.full(n, 0.7), 0.3, rate) == pytest.approx(0.7)
