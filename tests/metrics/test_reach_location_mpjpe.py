"""Reach Success, Location Error, Goal MPJPE and MPJPE: worked cases and slow references."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.metrics.final_pose import goal_mpjpe, location_error
from prbench.metrics.pose_errors import mpjpe
from prbench.metrics.reach_success import reach_success, reach_wrist
from tests.metrics.motions import CONSTANTS, batch, random_problem, standing

GOAL = np.array([[0.0, 1.0, 0.0]])


def wrists_at(left, right) -> np.ndarray:
    """Wrists on the x axis at these distances from the goal, left on +x."""
    motion = standing(len(left))
    motion[:, Joint.LEFT_WRIST] = GOAL + np.outer(left, (1, 0, 0))
    motion[:, Joint.RIGHT_WRIST] = GOAL - np.outer(right, (1, 0, 0))
    return motion


def test_reach_counts_any_frame_and_final_the_last_one() -> None:
    motion = batch(wrists_at([0.30, 0.099, 0.25], [0.4, 0.4, 0.101]))
    assert reach_success(motion, GOAL, CONSTANTS) == 1
    assert reach_success(motion, GOAL, CONSTANTS, final=True) == 0


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("distance", "expected"), [(0.10, 1), (0.1001, 0), (0.0999, 1)])
def test_exactly_ten_centimetres_is_a_success(distance: float, expected: float, dtype) -> None:
    for shift in (0.0, 0.3, 2.7):
        motion = wrists_at([0.5, distance], [0.5, 0.5]) + shift
        assert reach_success(batch(motion.astype(dtype)), GOAL + shift, CONSTANTS, final=True) == expected


@pytest.mark.parametrize(("beyond", "on"), [(0.9e-6, 1), (1.2e-6, 0)])
def test_a_distance_on_a_threshold_is_on_it_up_to_the_tolerance_of_the_protocol(beyond: float, on: float) -> None:
    motion = batch(wrists_at([0.5, 0.10 + beyond], [0.5, 0.5]))
    assert reach_success(motion, GOAL, CONSTANTS) == on
    strict = msgspec.structs.replace(CONSTANTS, threshold_tolerance=0.0)
    assert reach_success(motion, GOAL, strict) == 0
    nearer = standing(2) + np.array([0.5 - beyond, 0.0, 0.0])
    assert location_error(batch(nearer), batch(standing(2)), CONSTANTS) == on
    assert location_error(batch(nearer), batch(standing(2)), strict) == 0


def test_a_distance_exactly_on_a_threshold_is_reached_and_is_an_error() -> None:
    """``<=`` for the one and ``>=`` for the other, in numbers that floating point holds exactly."""
    exact = msgspec.structs.replace(
        CONSTANTS, threshold_tolerance=0.0, reach_distance=0.125, location_error_distance=0.5
    )
    motion = standing(2)
    motion[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]] = [0.125, 0.0, 0.0]
    assert reach_success(batch(motion), np.zeros((1, 3)), exact) == 1
    recorded = standing(2)
    recorded[:, Joint.PELVIS] = 0.0
    predicted = recorded.copy()
    predicted[:, Joint.PELVIS] = [0.0, 0.0, 0.5]
    assert location_error(batch(predicted), batch(recorded), exact) == 1
    assert location_error(batch(predicted), batch(recorded), exact, horizontal=True) == 1


def test_either_wrist_succeeds() -> None:
    motions = batch(
        wrists_at([0.5, 0.05], [0.5, 0.5]), wrists_at([0.5, 0.5], [0.5, 0.05]), wrists_at([0.5] * 2, [0.5] * 2)
    )
    assert reach_success(motions, np.repeat(GOAL, 3, axis=0), CONSTANTS).tolist() == [1, 1, 0]


@pytest.mark.parametrize(("hand", "expected"), [(0, 1), (1, 0), (-1, 0)])
def test_reach_wrist_aims_at_the_recorded_reaching_wrist(hand: int, expected: float) -> None:
    recorded = batch(wrists_at([0.9, 0.30], [0.9, 0.20]))  # the right one ends nearer to the goal
    predicted = batch(wrists_at([0.9, 0.35, 0.9], [0.9, 0.9, 0.9]))  # 5 cm from the recorded left one, in some frame
    assert reach_wrist(predicted, recorded, GOAL, np.array([hand]), CONSTANTS) == expected


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("offset", "full", "horizontal"),
    [((0.3, 0, 0.4), 1, 1), ((0.3, 0.1, 0.38), 0, 0), ((0.3, 0.2, 0.38), 1, 0), ((0, 0, 0), 0, 0)],
)
def test_location_error_worked_cases(offset: tuple, full: float, horizontal: float, dtype) -> None:
    for place in (0.0, 1.1, -3.3):
        recorded = standing(3) + place
        predicted = recorded.copy()
        predicted[-1] += offset
        pair = batch(predicted.astype(dtype)), batch(recorded.astype(dtype))
        assert location_error(*pair, CONSTANTS) == full
        assert location_error(*pair, CONSTANTS, horizontal=True) == horizontal


def test_only_the_last_pelvis_counts_for_location_error() -> None:
    predicted = standing(3)
    predicted[:2] += 5.0
    predicted[2, 1:] += 5.0
    assert location_error(batch(predicted), batch(standing(3)), CONSTANTS) == 0


def test_five_centimetres_in_the_last_of_four_frames() -> None:
    predicted = standing(4)
    predicted[-1] += (0.03, 0.04, 0.0)
    pair = batch(predicted), batch(standing(4))
    assert goal_mpjpe(*pair) == pytest.approx(0.05)
    assert mpjpe(*pair) == pytest.approx(0.0125)


@pytest.mark.parametrize("seed", range(3))
def test_agree_with_slow_references(seed: int) -> None:
    lengths = np.random.default_rng(seed).integers(1, 200, 60)
    predicted, recorded, where = random_problem(seed, lengths)
    constants = msgspec.structs.replace(CONSTANTS, location_error_distance=0.15, reach_distance=0.2)
    reach = reach_success(predicted, where.goal_location, constants)
    final = reach_success(predicted, where.goal_location, constants, final=True)
    wrist = reach_wrist(predicted, recorded, where.goal_location, where.hand, constants)
    error, goal_error, lost = (
        mpjpe(predicted, recorded),
        goal_mpjpe(predicted, recorded),
        location_error(predicted, recorded, constants),
    )
    for i, (a, b) in enumerate(zip(predicted.offsets, predicted.offsets[1:], strict=False)):
        p, r, goal = predicted.values[a:b], recorded.values[a:b], where.goal_location[i]
        near = [min(np.linalg.norm(frame[j] - goal) for j in (20, 21)) for frame in p]
        assert (reach[i], final[i]) == (min(near) <= 0.2, near[-1] <= 0.2)
        side = where.hand[i] if where.hand[i] >= 0 else np.argmin([np.linalg.norm(r[-1, j] - goal) for j in (20, 21)])
        assert wrist[i] == (min(np.linalg.norm(frame[j] - r[-1, 20 + side]) for frame in p for j in (20, 21)) <= 0.2)
        distances = [[np.linalg.norm(p[t, j] - r[t, j]) for j in range(22)] for t in range(b - a)]
        assert error[i] == pytest.approx(np.mean(distances), rel=1e-12)
        assert goal_error[i] == pytest.approx(np.mean(distances[-1]), rel=1e-12)
        assert lost[i] == (distances[-1][0] >= 0.15)
    for rate in (reach, final, wrist, lost):
        assert 0 < rate.sum() < 60
