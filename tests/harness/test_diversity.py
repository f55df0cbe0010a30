"""Diversity of several motions for one goal: cases by hand, laws, and the recorded people beside them."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.harness.controls import Tasks
from prbench.harness.diversity import SPREADS, MotionsToGoal, average_pairwise_distance, spreads, timing
from prbench.protocol.manifests import load_protocol
from tests.fakes import STANDING, fake_dataset

CONSTANTS = load_protocol().metrics
FRAMES = 81  # 4 s: the prime time of the protocol is in the middle
TILT = float(np.rad2deg(np.arctan2(0.06, 0.09)))  # of the standing body's head, which then looks straight ahead
GOAL = np.array([0.0, 1.6, 2.0])  # before the body, at the height of its head


def turned(yaw: np.ndarray) -> np.ndarray:
    """The standing body, turned about the vertical by an angle a frame; radians, 0 faces the goal."""
    turn = np.zeros((len(yaw), 3, 3))
    turn[:, 0, 0] = turn[:, 2, 2] = np.cos(yaw)
    turn[:, 0, 2] = np.sin(yaw)
    turn[:, 2, 0] = -np.sin(yaw)
    turn[:, 1, 1] = 1.0
    return np.einsum("tij,kj->tki", turn, STANDING).astype(np.float32)


def arriving(frame: int = 40) -> np.ndarray:
    """A body that turns from the side to the goal, ever slower until it faces it in a frame."""
    left = np.clip((frame - np.arange(FRAMES)) / 20, 0, 1)
    return turned(1.5 * left**2)


def reaching(motion: np.ndarray) -> np.ndarray:
    reached = motion.copy()
    reached[-1, Joint.RIGHT_WRIST] = GOAL
    return reached


def motions(*each: np.ndarray) -> MotionsToGoal:
    return MotionsToGoal(np.stack(each).astype(np.float64), GOAL, TILT, 20.0)


def walking(end: tuple[float, float], frames: int = FRAMES, share: float = 1.0) -> np.ndarray:
    """The standing body slides straight to an end on the ground, within the first share of the time."""
    progress = np.minimum(np.linspace(0.0, 1.0, frames) / share, 1.0)
    step = progress[:, None] * np.array([end[0], 0.0, end[1]])
    return (STANDING + step[:, None]).astype(np.float64)


def test_apd_is_the_worked_example_of_the_specification():
    still = np.zeros((2, 1, 3))
    still[:, 0, 0] = 1.0
    jumping = np.zeros((2, 1, 3))
    jumping[1, 0, 1] = 3.0
    assert average_pairwise_distance(np.stack([still, jumping])) == pytest.approx(3.316625, abs=1e-6)


def test_equal_motions_differ_in_nothing():
    one = reaching(arriving())
    found = spreads(motions(one, one, one), CONSTANTS)
    assert list(found) == list(SPREADS)
    assert found == pytest.approx(dict.fromkeys(found, 0.0), abs=1e-12)


def test_a_body_moved_aside_differs_by_the_move_and_in_nothing_else():
    moved = STANDING + np.array([0.3, 0.0, 0.4])
    found = spreads(motions(np.tile(STANDING, (FRAMES, 1, 1)), np.tile(moved, (FRAMES, 1, 1))), CONSTANTS)
    assert found["apd_joint"] == pytest.approx(0.5)
    assert found["apd"] == pytest.approx(0.5 * np.sqrt(FRAMES * 22))
    assert found["path"] == pytest.approx(0.5)
    assert found["apd_pose"] == pytest.approx(0.0)
    assert found["wrist_speed"] == pytest.approx(0.0)


def test_the_same_way_at_another_speed_is_the_same_path_with_another_timing():
    slow = walking((0.0, 1.0))
    quick = walking((0.0, 1.0), share=0.5)
    found = spreads(motions(slow, quick), CONSTANTS)
    assert found["path"] == pytest.approx(0.0, abs=1e-9)
    assert list(timing(motions(slow, quick), CONSTANTS).half_way) == [2.0, 1.0]
    assert found["half_way"] == pytest.approx(np.std([2.0, 1.0], ddof=1))
    assert found["wrist_speed"] == pytest.approx(0.25, abs=0.01)


def test_two_ways_that_part_by_a_right_angle():
    found = spreads(motions(walking((1.0, 0.0)), walking((0.0, 1.0))), CONSTANTS)
    assert found["path"] == pytest.approx(np.sqrt(2) / 2)  # mean of 0 to √2 over the way
    assert found["half_way"] == pytest.approx(0.0)


def test_prime_time_is_that_of_the_first_look_that_stays_else_of_the_best_one():
    glancing = turned(np.full(FRAMES, 2.0)).astype(np.float64)
    glancing[10] = turned(np.zeros(1))[0]  # one frame is no stay
    glancing[30:33] = turned(np.full(3, 0.3))  # and this is the best there is, 0.57 m beside the goal
    primes = timing(motions(arriving(40), arriving(60), glancing), CONSTANTS).prime
    assert primes[1] - primes[0] == pytest.approx(1.0)
    assert primes[2] == pytest.approx(1.5)


def test_a_wrist_arrives_where_it_stays_near_its_end():
    quick = np.tile(STANDING, (FRAMES, 1, 1))
    slow = quick.copy()
    quick[20:, Joint.RIGHT_WRIST] = GOAL
    slow[60:, Joint.RIGHT_WRIST] = GOAL
    still = np.tile(STANDING, (FRAMES, 1, 1))
    assert list(timing(motions(quick, slow, still), CONSTANTS).wrist_arrival) == [1.0, 3.0, 0.0]


def test_neither_the_order_of_motions_nor_a_turned_world_changes_a_spread():
    three = motions(reaching(arriving(40)), arriving(55), walking((0.4, 1.0)))
    first = spreads(three, CONSTANTS)
    assert spreads(motions(*three.joints[::-1]), CONSTANTS) == pytest.approx(first)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    there = MotionsToGoal(three.joints @ turn.T + 5.0, turn @ GOAL + 5.0, TILT, 20.0)
    assert spreads(there, CONSTANTS) == pytest.approx(first)


def test_one_motion_differs_from_nothing():
    with pytest.raises(ValueError, match="expected two motions or more"):
        motions(arriving())


def test_similar_tasks_are_those_of_other_recordings_by_goal_and_length(tmp_path):
    tasks = Tasks.read(fake_dataset(tmp_path / "table", 48))
    found = tasks.most_similar(7, 5)
    own = tasks.recording_ids[7]
    assert own not in tasks.recording_ids[found]
    distance = np.hypot(
        np.linalg.norm(tasks.goal_location - tasks.goal_location[7], axis=1), 0.5 * (tasks.seconds - tasks.seconds[7])
    )
    others = tasks.recording_ids != own
    assert np.sort(distance[found]) == pytest.approx(np.sort(distance[others])[:5])
