"""``prbench analyse tell-apart``: what its classifier learns from, and how well it tells kinds of motions apart."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.randomness import named_generator
from prbench_benchmarks.prime_and_reach.telling_apart import _area, held_out_features
from tests.fakes import smooth_motion


def motions(count: int = 2) -> np.ndarray:
    return np.stack([smooth_motion(f"told apart {number}", 40) for number in range(count)]).astype(np.float64)


def test_features_do_not_depend_on_where_a_motion_is_and_which_way_it_goes() -> None:
    turned = motions()[..., [2, 1, 0]] * [-1.0, 1.0, 1.0] + [3.0, 0.0, -2.0]
    assert held_out_features(turned, 20.0) == pytest.approx(held_out_features(motions(), 20.0), abs=0.05)


def test_features_know_nothing_finer_than_what_a_film_shows() -> None:
    nudged = np.round(motions(), 3) + 4e-4 * np.sign(named_generator("nudge").normal(size=(2, 40, 22, 3)))
    assert held_out_features(nudged, 20.0).tolist() == held_out_features(motions(), 20.0).tolist()


def test_a_trembling_body_has_more_speed_and_as_much_tilt() -> None:
    still, trembling = held_out_features(
        np.stack([motions()[0], motions()[0] + 0.01 * named_generator("tremble").normal(size=(40, 22, 3))]), 20.0
    ).reshape(2, 4, 21)
    assert np.abs(still - trembling)[0].max() < 5.0
    assert (trembling[3] > still[3] + 0.3).all()


@pytest.mark.parametrize(("apart", "low", "high"), [(0.0, 0.35, 0.65), (1.0, 0.65, 0.87), (9.0, 1.0, 1.0)])
def test_the_area_grows_with_how_far_two_kinds_are_apart(apart, low, high) -> None:
    """One feature of two normal distributions of which one is shifted by d deviations has an area of Φ(d / √2)."""
    second = np.tile([False, True], 100)
    features = named_generator("area", str(apart)).normal(size=(200, 3))
    features[:, 0] += apart * second
    found = _area(features, second, np.repeat(np.arange(50), 4))
    assert low <= found.mean <= high
    assert found.n_recordings == 50
    assert found.high is None or found.low <= found.mean <= found.high <= 1.0


def test_the_interval_of_independent_motions_is_that_of_hanley_and_mcneil() -> None:
    second = np.tile([False, True], 1000)
    features = named_generator("interval").normal(size=(2000, 1)) + second[:, None]
    found = _area(features, second, np.arange(2000))
    a = found.mean
    spread = a * (1 - a) + 999 * (a / (2 - a) - a**2) + 999 * (2 * a**2 / (1 + a) - a**2)
    assert found.high is not None
    assert found.high - a == pytest.approx(1.96 * (spread / 1000**2) ** 0.5, rel=0.1)


def test_equal_motions_cannot_be_told_apart() -> None:
    features = np.repeat(named_generator("equal").normal(size=(40, 3)), 2, axis=0)
    assert _area(features, np.tile([False, True], 40), np.repeat(np.arange(20), 4)).mean == pytest.approx(0.5)
