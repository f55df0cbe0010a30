"""Causes of missed primes and reaches, on motions whose cause is known by construction."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.metrics import MotionBatch, ScoringTargets
from prbench.metrics.prime_success import prime_success
from prbench.protocol.manifests import load_protocol
from prbench_benchmarks.prime_and_reach.error_budget import looking
from prbench_benchmarks.prime_and_reach.error_budget import motions as reaching
from prbench_benchmarks.prime_and_reach.error_budget.budget import gain
from prbench_benchmarks.prime_and_reach.error_budget.motions import diagnose_bodies
from tests.fakes import STANDING

CONSTANTS = load_protocol().metrics
FPS = 20.0
PRIME = 2.0
FRAMES = 100
TIME = np.arange(FRAMES) / FPS - PRIME
HEAD_HEIGHT = 1.6


def body(yaw_deg, pitch_deg=0.0) -> np.ndarray:
    """A body on the spot whose ray (tilt 0) has the given azimuth and elevation; one value a frame."""
    yaw = np.deg2rad(np.broadcast_to(yaw_deg, FRAMES))
    lean = -np.deg2rad(np.broadcast_to(pitch_deg, FRAMES))
    joints = np.repeat(STANDING[None], FRAMES, axis=0)
    joints[:, Joint.NECK] = [0.0, HEAD_HEIGHT - 0.1, 0.0]
    x = joints[..., 0].copy()
    z = joints[..., 2].copy()
    joints[..., 0] = x * np.cos(yaw)[:, None] + z * np.sin(yaw)[:, None]
    joints[..., 2] = z * np.cos(yaw)[:, None] - x * np.sin(yaw)[:, None]
    bone = np.stack((np.sin(lean) * np.sin(yaw), np.cos(lean), np.sin(lean) * np.cos(yaw)), axis=1)
    joints[:, Joint.HEAD] = joints[:, Joint.NECK] + 0.1 * bone
    return joints


def targets(goal=(0.0, HEAD_HEIGHT, 1.5)) -> ScoringTargets:
    return ScoringTargets(np.array([goal]), np.array([PRIME]), np.array([-1]), np.array([0.0]), FPS)


def look(joints, **settings) -> dict[str, np.ndarray]:
    return looking.diagnose_looking(MotionBatch.from_motions([joints]), targets(**settings), CONSTANTS)


SETTLES = 60 * np.exp(-2.5 * (TIME + PRIME))  # turns to the goal ever more slowly
TURNS = {
    looking.PRIMED: SETTLES,
    looking.SLOW: -40 * TIME,
    looking.STAY: np.where(TIME < 0, 80.0, np.where(TIME < 0.04, 0.0, -80.0)),
    looking.LATE: np.where(TIME > 1.5, 0.0, 60.0),
    looking.EARLY: np.where(TIME < -1.5, 0.0, 60.0),
    looking.MISS: np.full(FRAMES, 20.0),
    looking.NEVER: np.full(FRAMES, 90.0),
}


@pytest.mark.parametrize("cause", TURNS)
def test_the_cause_is_that_of_the_construction(cause):
    assert look(body(TURNS[cause]))["cause"] == [cause]


@pytest.mark.parametrize("cause", TURNS)
def test_primed_is_what_the_metric_says(cause):
    motion = MotionBatch.from_motions([body(TURNS[cause])])
    assert (look(body(TURNS[cause]))["cause"] == [looking.PRIMED]) == prime_success(motion, targets(), CONSTANTS)[0]


def test_a_motion_too_short_for_a_candidate_is_undefined():
    found = look(body(0.0)[:3])
    assert found["cause"] == [looking.UNDEFINED]
    assert np.isnan(found["miss_deg"][0])


def test_a_ray_above_the_goal_misses_upwards_and_would_stay_with_the_goals_elevation():
    found = look(body(0.0, 18.0))
    assert found["cause"] == [looking.MISS]
    assert found["miss_deg"][0] == pytest.approx(18, abs=1.5)  # a head that leans back is not where it would be upright
    assert found["miss_up_deg"][0] == pytest.approx(18, abs=1.5)
    assert found["miss_aside_deg"][0] == pytest.approx(0, abs=1e-6)
    assert (found["stays"][0], found["stays_with_elevation"][0], found["stays_with_azimuth"][0]) == (False, True, False)


def test_a_ray_to_the_left_of_the_goal_misses_aside_and_would_stay_with_the_goals_azimuth():
    found = look(body(20.0))
    assert found["miss_aside_deg"][0] == pytest.approx(20)
    assert found["miss_up_deg"][0] == pytest.approx(0, abs=1e-6)
    assert (found["stays"][0], found["stays_with_elevation"][0], found["stays_with_azimuth"][0]) == (False, False, True)


def test_angles_are_compared_across_the_half_turn():
    found = look(body(179.0), goal=(-0.05, HEAD_HEIGHT, -1.5))
    assert abs(found["miss_aside_deg"][0]) < 5
    assert abs(found["ray_azimuth_deg"][0] - found["goal_azimuth_deg"][0]) < 5


def test_times_are_told_from_the_prime_time():
    found = look(body(TURNS[looking.LATE]))
    assert found["first_look"][0] == pytest.approx(1.55)
    assert found["longest_stay"][0] == 0
    assert look(body(np.zeros(FRAMES)))["longest_stay"][0] == pytest.approx(FRAMES / FPS)


def wrist_motion(distance) -> np.ndarray:
    """A standing body whose right wrist is that many metres from the goal, one value a frame; the left one is away."""
    distance = np.asarray(distance, dtype=float)
    joints = np.repeat(STANDING[None], len(distance), axis=0)
    joints[:, Joint.RIGHT_SHOULDER] = [0.0, 1.0, 0.2]
    joints[:, Joint.RIGHT_ELBOW] = [0.0, 1.3, 0.2]
    joints[:, Joint.RIGHT_WRIST] = 0.0
    joints[:, Joint.RIGHT_WRIST, 1] = 1.0
    joints[:, Joint.RIGHT_WRIST, 2] = 0.5 - distance
    joints[:, Joint.LEFT_WRIST] = [0.0, 0.0, -2.0]
    return joints


def reach(joints, goal=(0.0, 1.0, 0.5)) -> dict[str, np.ndarray]:
    return reaching.diagnose_reaching(MotionBatch.from_motions([joints]), targets(goal), CONSTANTS)


@pytest.mark.parametrize(
    ("cause", "distance"),
    [
        (reaching.REACHED, np.linspace(0.4, 0.05, 40)),
        (reaching.LEAVES, np.abs(np.linspace(-0.2, 0.2, 40)) + 0.15),
        (reaching.UNDER_WAY, np.linspace(0.4, 0.15, 40)),
        (reaching.SHORT, np.concatenate((np.linspace(0.4, 0.15, 20), np.full(20, 0.15)))),
    ],
)
def test_the_cause_of_a_reach(cause, distance):
    found = reach(wrist_motion(distance))
    assert found["cause"] == [cause]
    assert found["smallest"][0] == pytest.approx(distance.min())
    assert found["final"][0] == pytest.approx(distance[-1])


def test_a_shoulder_that_is_too_far_away():
    found = reach(wrist_motion(np.full(30, 0.0)), goal=(0.0, 1.0, 1.5))
    assert found["cause"] == [reaching.FAR]
    assert found["slack"][0] == pytest.approx(0.3 + np.hypot(0.3, 0.3) - 1.3)


def test_slides_are_told_by_phase_and_the_worst_bone_by_name():
    joints = body(0.0)
    joints[80:, :, 0] += np.linspace(0, 0.5, 20)[:, None]  # the whole body glides at 0.5 m/s in the last second
    joints[50, Joint.LEFT_WRIST, 1] -= 0.1
    found = diagnose_bodies(MotionBatch.from_motions([joints]), targets(), CONSTANTS)
    assert found["slides_before"][0] == 0
    assert found["slides_way"][0] < 0.05
    assert found["slides_end"][0] > 0.9
    assert found["worst_bone"] == ["left elbow-left wrist"]


def test_a_gain_is_the_slope():
    goal = np.linspace(-60, 10, 20)
    found = gain(goal, 0.5 * goal - 3)
    assert found == pytest.approx((0.5, -3, 1))
    assert gain(np.zeros(5), np.arange(5.0)) is None
